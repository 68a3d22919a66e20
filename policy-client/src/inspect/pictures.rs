//! Pictures of the camera's image and the LiDAR's scan.

use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, Polyline, PrimitiveStyle, Rectangle};
use embedded_graphics::text::Alignment;
use fiatlux_proto::v3::Image;

use super::picture::{Label, Picture, label};
use super::scan::{COLUMNS, RANGE, ROWS, Scan};

const BACKGROUND: Rgb888 = Rgb888::new(24, 24, 28);
const GROUND: Rgb888 = Rgb888::new(12, 12, 14);
const INK: Rgb888 = Rgb888::new(200, 200, 205);
const RING: Rgb888 = Rgb888::new(70, 70, 78);
const FLOOR_HIT: Rgb888 = Rgb888::new(110, 110, 120);
const THING: Rgb888 = Rgb888::new(255, 110, 110);

/// Side of a ray's square, and width of the margin, pixels.
const RAY: u32 = 4;
const MARGIN: i32 = 20;
/// Top of the scan, below its title and its axis.
const TOP: i32 = 40;
/// Side of the view from above, pixels, and its range in each direction, m.
const SIDE: i32 = RAY as i32 * COLUMNS as i32;
const REACH: f64 = 5.0;
/// Height of a scale's strip, and of the scale with its numbers.
const STRIP: i32 = 12;
const SCALE: i32 = 46;
/// Shortest range with a colour of its own, m.
const NEAR: f64 = 0.3;
/// Height from which all points have the last colour, m.
const HIGH: f64 = 2.0;
/// A point below this height (m) is floor; the limit rises by the second number per metre of distance, because the
/// angles are noisy.
const FLOOR: [f64; 2] = [0.05, 0.03];

/// Dark violet, blue, green, yellow, in steps that look equal: matplotlib's viridis at eighths.
const RAMP: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// The camera's image at twice its size; `None` if its bytes do not form an image.
pub fn camera(image: &Image) -> Option<Picture> {
    let (width, height) = (image.width as usize, image.height as usize);
    let whole = width > 0 && height > 0 && image.rgb.len() == 3 * width * height;
    whole.then(|| Picture { width, height, rgb: image.rgb.clone() }.enlarged(2))
}

/// The ranges as seen by the robot, bright when near, and the hits from above. `None` if the ranges do not form a scan.
pub fn lidar(ranges: &[f32], scan: Option<&Scan>) -> Option<Picture> {
    if ranges.len() != ROWS * COLUMNS {
        return None;
    }
    let legend = TOP + (RAY as usize * ROWS) as i32 + STRIP;
    let above = legend + SCALE;
    let height = if scan.is_some() { above + 14 + SIDE + MARGIN + SCALE } else { above };
    let mut picture = Picture::new((SIDE + 2 * MARGIN) as usize, height as usize, BACKGROUND);
    write(&mut picture, "LiDAR: range in each direction, as the robot sees it", SIDE / 2, 3);
    for (name, share) in [("back", 0), ("left", 1), ("front", 2), ("right", 3), ("back", 4)] {
        let x = SIDE * share / 4;
        write(&mut picture, name, x, TOP - 21);
        picture.fill(MARGIN + x.min(SIDE - 1), TOP - 7, 1, 5, INK);
    }
    for (ray, range) in ranges.iter().enumerate() {
        let [row, column] = [ray / COLUMNS, ray % COLUMNS].map(|index| index as i32 * RAY as i32);
        let color = if *range < RANGE { by_range(f64::from(*range)) } else { Rgb888::BLACK };
        picture.fill(MARGIN + column, TOP + row, RAY, RAY, color);
    }
    let no_hit = 60;
    let marks = [0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0].map(|range| (share_of(range), format!("{range} m")));
    scale(&mut picture, legend, SIDE - 2 * no_hit, &marks, |share| by_range(range_at(share)));
    picture.fill(MARGIN + SIDE - no_hit, legend, no_hit as u32, STRIP as u32, Rgb888::BLACK);
    write(&mut picture, "no hit", SIDE - no_hit / 2, legend + STRIP + 6);
    if let Some(scan) = scan {
        from_above(&mut picture, scan, above + 14);
    }
    Some(picture)
}

/// Draws the hits around the robot, which faces the top of the picture.
fn from_above(picture: &mut Picture, scan: &Scan, top: i32) {
    let pixels = f64::from(SIDE) / 2.0 / REACH;
    let place = |x: f64, y: f64| {
        let [left, up] = [MARGIN, top].map(|edge| f64::from(edge + SIDE / 2));
        Point::new((left - pixels * y) as i32, (up - pixels * x) as i32)
    };
    let inside = |[x, y, _]: &[f64; 3]| x.abs() < REACH && y.abs() < REACH;
    let area = Rectangle::new(Point::new(MARGIN, top), Size::new_equal(SIDE as u32));
    write(picture, "the same from above, front up: grey is floor, else colour is height", SIDE / 2, top - 15);
    picture.put(&area.into_styled(PrimitiveStyle::with_fill(GROUND)));
    for ring in 1..=REACH as u32 {
        let circle = Circle::with_center(place(0.0, 0.0), 2 * (pixels * f64::from(ring)) as u32);
        picture.put(&circle.into_styled(PrimitiveStyle::with_stroke(RING, 1)));
    }
    // Draw the highest hits last, so that they are on top.
    let mut points: Vec<&[f64; 3]> = scan.points.iter().filter(|point| inside(point)).collect();
    points.sort_by(|a, b| a[2].total_cmp(&b[2]));
    let mut hits = Vec::new();
    for [x, y, z] in points {
        let at = place(*x, *y);
        let is_floor = *z < FLOOR[0] + FLOOR[1] * x.hypot(*y);
        hits.extend((!is_floor).then_some(at));
        let (size, color) = if is_floor { (2, FLOOR_HIT) } else { (3, ramp(z / HIGH)) };
        picture.fill(at.x - 1, at.y - 1, size, size, color);
    }
    let corners = [place(-0.15, 0.18), place(0.25, 0.0), place(-0.15, -0.18)];
    let robot = Polyline::new(&corners).into_styled(PrimitiveStyle::with_stroke(Rgb888::WHITE, 3));
    picture.put(&robot);
    let mut taken = vec![robot.bounding_box()];
    for ring in 1..=REACH as u32 {
        let text = format!("{ring} m");
        let radius = f64::from(ring);
        let ring = label(&text, place(-radius, 0.0) - Point::new(0, 15), Alignment::Center, INK, GROUND);
        picture.put(&ring);
        taken.push(ring.bounding_box());
    }
    let things: Vec<(&str, Point)> =
        scan.things.iter().filter(|(_, at)| inside(at)).map(|(name, [x, y, _])| (*name, place(*x, *y))).collect();
    for (_, at) in &things {
        for slope in [Point::new(6, 6), Point::new(6, -6)] {
            picture.put(&Line::new(*at - slope, *at + slope).into_styled(PrimitiveStyle::with_stroke(THING, 2)));
        }
        taken.push(Rectangle::with_center(*at, Size::new_equal(15)));
    }
    for (name, at) in things {
        if let Some(name) = beside(name, at, &area, &taken, &hits) {
            picture.put(&name);
            taken.push(name.bounding_box());
        }
    }
    let marks = [0.0, 0.5, 1.0, 1.5, HIGH].map(|height| (height / HIGH, format!("{height} m")));
    scale(picture, top + SIDE + STRIP, SIDE, &marks, ramp);
}

/// A place for a name near its mark: off the names already drawn, and over as few hits as possible.
fn beside<'a>(name: &'a str, at: Point, area: &Rectangle, taken: &[Rectangle], hits: &[Point]) -> Option<Label<'a>> {
    let around = |away: i32| {
        [
            (Point::new(0, 9 + away), Alignment::Center),
            (Point::new(0, -22 - away), Alignment::Center),
            (Point::new(11 + away, -6), Alignment::Left),
            (Point::new(-11 - away, -6), Alignment::Right),
        ]
    };
    let ends = |area: Rectangle| [area.top_left.x, area.top_left.x + area.size.width as i32];
    let places = (0..16).flat_map(|times| around(6 * times));
    let labels = places.map(|(offset, alignment)| {
        let label = label(name, at + offset, alignment, THING, GROUND);
        // Inside the area if the mark is near its edge.
        let ([left, right], [first, last]) = (ends(label.bounding_box()), ends(*area));
        label.translate(Point::new((first - left).max(0) - (right - last).max(0), 0))
    });
    let is_free = |label: &Label| {
        let text = label.bounding_box();
        text.intersection(area) == text && taken.iter().all(|other| text.intersection(other).is_zero_sized())
    };
    let covered = |label: &Label| hits.iter().filter(|hit| label.bounding_box().contains(**hit)).count();
    labels.filter(is_free).min_by_key(covered)
}

/// Draws a strip of colours with labels below, placed by their share of its width.
fn scale(picture: &mut Picture, top: i32, width: i32, marks: &[(f64, String)], color: impl Fn(f64) -> Rgb888) {
    for x in 0..width {
        picture.fill(MARGIN + x, top, 1, STRIP as u32, color(f64::from(x) / f64::from(width)));
    }
    for (share, text) in marks {
        let x = (share * f64::from(width)) as i32;
        picture.fill(MARGIN + x.min(SIDE - 1), top + STRIP, 1, 4, INK);
        write(picture, text, x, top + STRIP + 6);
    }
}

/// Writes a text centred at `x`, but not beyond the edges.
fn write(picture: &mut Picture, text: &str, x: i32, top: i32) {
    let half = label(text, Point::zero(), Alignment::Left, INK, BACKGROUND).bounding_box().size.width as i32 / 2;
    let x = x.clamp(half, (SIDE - half).max(half));
    picture.put(&label(text, Point::new(MARGIN + x, top), Alignment::Center, INK, BACKGROUND));
}

/// Position of a range between the shortest and the longest, on a logarithmic scale from 0 to 1.
fn share_of(range: f64) -> f64 {
    (range.max(NEAR) / NEAR).ln() / (f64::from(RANGE) / NEAR).ln()
}

fn range_at(share: f64) -> f64 {
    NEAR * (f64::from(RANGE) / NEAR).powf(share)
}

/// Colour of a range: near hits are bright.
fn by_range(range: f64) -> Rgb888 {
    ramp(1.0 - share_of(range))
}

/// A colour from the ramp, between its ends 0 and 1.
fn ramp(share: f64) -> Rgb888 {
    let at = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let below = (at as usize).min(RAMP.len() - 2);
    let part = at - below as f64;
    let [r, g, b] = [0, 1, 2].map(|channel| {
        let [low, high] = [RAMP[below][channel], RAMP[below + 1][channel]].map(f64::from);
        (low + part * (high - low)).round() as u8
    });
    Rgb888::new(r, g, b)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn luma(color: Rgb888) -> f64 {
        0.2126 * f64::from(color.r()) + 0.7152 * f64::from(color.g()) + 0.0722 * f64::from(color.b())
    }

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let shades = [0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 9.9].map(|range| luma(by_range(range)));
        assert!(shades.windows(2).all(|pair| pair[0] >= pair[1]) && shades[0] > shades[6] + 100.0, "{shades:?}");
        let ends = [-1.0, 1.0].map(|share| [ramp(share).r(), ramp(share).g(), ramp(share).b()]);
        assert_eq!(ends, [RAMP[0], RAMP[8]]);
        let mut ranges = vec![RANGE; ROWS * COLUMNS];
        ranges[COLUMNS + 2] = 0.3;
        let canvas = lidar(&ranges, None).unwrap();
        let pixel = |x: usize, y: usize| &canvas.rgb[3 * (y * canvas.width + x)..][..3];
        let [left, top] = [20, 40];
        assert_eq!(pixel(left + 4 * 2, top + 4), RAMP[8]);
        assert_eq!(pixel(left + 4 * 2 + 3, top + 4 + 3), RAMP[8]);
        assert_eq!(pixel(left + 4 * 3, top + 4), [0; 3]);
        assert!((range_at(share_of(2.5)) - 2.5).abs() < 1e-12);
    }

    /// A thing in front of the robot is above the middle of the picture, and one on its left is on the left.
    #[test]
    fn from_above_the_robot_looks_up() {
        let ranges = vec![RANGE; ROWS * COLUMNS];
        let points = vec![[2.0, 1.0, 2.0]];
        let empty = lidar(&ranges, Some(&Scan { points: Vec::new(), things: Vec::new() })).unwrap();
        let canvas = lidar(&ranges, Some(&Scan { points, things: Vec::new() })).unwrap();
        let changed: Vec<usize> =
            (0..canvas.rgb.len() / 3).filter(|at| canvas.rgb[3 * at..][..3] != empty.rgb[3 * at..][..3]).collect();
        assert_eq!(changed.len(), 9);
        let (x, y) = (changed[4] % canvas.width, changed[4] / canvas.width);
        // 72 pixels for each metre.
        let middle = canvas.width / 2;
        let centre = empty.height - 46 - 20 - 360;
        assert_eq!((x, y), (middle - 72, centre - 144));
    }

    /// Five things at one place, in a corner of the picture.
    #[test]
    fn names_keep_off_each_other() {
        let area = Rectangle::new(Point::zero(), Size::new_equal(200));
        let at = Point::new(5, 190);
        let mut taken = vec![Rectangle::with_center(at, Size::new_equal(15))];
        for name in ["ladder", "crate", "fresh bulb", "old bulb", "socket"] {
            let label = beside(name, at, &area, &taken, &[]).unwrap().bounding_box();
            assert!(taken.iter().all(|other| label.intersection(other).is_zero_sized()), "{name}");
            assert_eq!(label.intersection(&area), label, "{name}");
            taken.push(label);
        }
    }

    #[test]
    fn what_is_no_picture_is_none() {
        assert!(lidar(&[1.0; 7], None).is_none());
        assert!(camera(&Image { width: 2, height: 2, rgb: vec![0; 11] }).is_none());
        let twice = camera(&Image { width: 2, height: 1, rgb: vec![0; 6] }).unwrap();
        assert_eq!((twice.width, twice.height), (4, 2));
    }
}
