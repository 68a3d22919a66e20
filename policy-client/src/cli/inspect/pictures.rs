//! Pictures of what the camera and the LiDAR see.

use fiatlux_proto::v3::Image;

use super::canvas::{Canvas, Color};
use super::scan::{COLUMNS, RANGE, ROWS, Scan};

const BACKGROUND: Color = [24, 24, 28];
const INK: Color = [200, 200, 205];
const FAINT: Color = [70, 70, 78];
const THING: Color = [255, 90, 90];

/// Pixels of a ray's square, and around everything.
const RAY: usize = 4;
const MARGIN: i64 = 20;
/// Side of the view from above, pixels, and what it shows in each direction, m.
const ABOVE: i64 = (RAY * COLUMNS) as i64;
const REACH: f64 = 5.0;
/// Nearest range that has a colour of its own, m.
const NEAR: f64 = 0.3;
/// Height that has the last colour, m.
const HIGH: f64 = 2.0;
/// A point below this is floor, m, and so much more a metre away: the angles that place it are noisy.
const FLOOR: [f64; 2] = [0.05, 0.03];

/// Dark violet, blue, green, yellow, in steps that look equal: matplotlib's viridis at eighths.
const RAMP: [Color; 9] = [
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

/// The camera's image, twice its size; `None` where its bytes are not those of an image.
pub fn camera(image: &Image) -> Option<Canvas> {
    let (width, height) = (image.width as usize, image.height as usize);
    let whole = width > 0 && height > 0 && image.rgb.len() == 3 * width * height;
    whole.then(|| Canvas { width, height, rgb: image.rgb.clone() }.enlarged(2))
}

/// The ranges as the robot sees them, near ones bright, and their hits from above. `None` where they are not those of a
/// scan.
pub fn lidar(ranges: &[f32], scan: Option<&Scan>) -> Option<Canvas> {
    if ranges.len() != ROWS * COLUMNS {
        return None;
    }
    let (wide, high) = ((RAY * COLUMNS) as i64, (RAY * ROWS) as i64);
    let legend = MARGIN + 20 + high + 12;
    let above = legend + 46;
    let height = if scan.is_some() { above + 14 + ABOVE + MARGIN + 46 } else { above };
    let mut canvas = Canvas::new((wide + 2 * MARGIN) as usize, height as usize, BACKGROUND);
    for (column, name) in [(0, "back"), (45, "left"), (90, "front"), (135, "right"), (180, "back")] {
        let x = MARGIN + column * RAY as i64;
        let middle = x.clamp(MARGIN + 15, MARGIN + wide - 17);
        canvas.write_at(middle, MARGIN - 6, name, INK);
        canvas.fill(x, MARGIN + 8, 1, 8, INK);
    }
    for (ray, range) in ranges.iter().enumerate() {
        let (row, column) = ((ray / COLUMNS) as i64, (ray % COLUMNS) as i64);
        let side = RAY as i64;
        let color = if *range < RANGE { by_range(f64::from(*range)) } else { [0; 3] };
        canvas.fill(MARGIN + side * column, MARGIN + 20 + side * row, side, side, color);
    }
    let nothing = 60;
    let strip = wide - 2 * nothing;
    strip_of(&mut canvas, legend, strip, |share| by_range(range_at(share)));
    for range in [0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0] {
        let x = MARGIN + (share_of(range) * strip as f64) as i64;
        canvas.fill(x, legend + 12, 1, 4, INK);
        canvas.write_at(x, legend + 18, &format!("{range}{}", if range == 10.0 { " m" } else { "" }), INK);
    }
    canvas.fill(MARGIN + wide - nothing, legend, nothing, 12, [0; 3]);
    canvas.write_at(MARGIN + wide - nothing / 2, legend + 18, "no hit", INK);
    if let Some(scan) = scan {
        from_above(&mut canvas, scan, above);
    }
    Some(canvas)
}

/// The hits around the robot, which looks up the picture.
fn from_above(canvas: &mut Canvas, scan: &Scan, top: i64) {
    let scale = ABOVE as f64 / 2.0 / REACH;
    let centre = [MARGIN as f64 + ABOVE as f64 / 2.0, (top + 14) as f64 + ABOVE as f64 / 2.0];
    let place = |x: f64, y: f64| [centre[0] - scale * y, centre[1] - scale * x];
    let inside = |x: f64, y: f64| x.abs() < REACH && y.abs() < REACH;
    canvas.write_at(centre[0] as i64, top, "from above, front up. grey is floor, else height", INK);
    canvas.fill(MARGIN, top + 14, ABOVE, ABOVE, [12, 12, 14]);
    for ring in 1..=REACH as i64 {
        let radius = ring as f64;
        for step in 0..720 {
            let (y, x) = (f64::from(step) / 720.0 * std::f64::consts::TAU).sin_cos();
            let [x, y] = place(radius * x, radius * y);
            canvas.set(x as i64, y as i64, FAINT);
        }
        let [x, y] = place(0.0, -radius);
        canvas.write(x as i64 - 20, y as i64 - 14, &format!("{ring} m"), FAINT);
    }
    // The highest last, on top.
    let mut points: Vec<&[f64; 3]> = scan.points.iter().filter(|point| inside(point[0], point[1])).collect();
    points.sort_by(|a, b| a[2].total_cmp(&b[2]));
    for [x, y, z] in points {
        let [left, up] = place(*x, *y).map(|at| at as i64);
        let floor = FLOOR[0] + FLOOR[1] * x.hypot(*y);
        let (size, color) = if *z < floor { (2, [110, 110, 120]) } else { (3, ramp(z / HIGH)) };
        canvas.fill(left - 1, up - 1, size, size, color);
    }
    let nose = place(0.25, 0.0);
    for heel in [place(-0.15, 0.18), place(-0.15, -0.18)] {
        canvas.line(heel, nose, 3, [255; 3]);
    }
    let mut names: Vec<[i64; 3]> = Vec::new();
    for (name, [x, y, _]) in scan.things.iter().filter(|(_, [x, y, _])| inside(*x, *y)) {
        let [x, y] = place(*x, *y);
        canvas.line([x - 6.0, y - 6.0], [x + 6.0, y + 6.0], 2, THING);
        canvas.line([x - 6.0, y + 6.0], [x + 6.0, y - 6.0], 2, THING);
        // Names stand below each other where things stand close.
        let half = 4 * name.chars().count() as i64 + 4;
        let (x, mut y) = (x as i64, y as i64 + 10);
        while names.iter().any(|[left, up, width]| (x - left).abs() < half + width && (y - up).abs() < 12) {
            y += 12;
        }
        names.push([x, y, half]);
        canvas.write_at(x, y, name, THING);
    }
    let legend = top + 14 + ABOVE + 12;
    strip_of(canvas, legend, ABOVE, ramp);
    for height in [0.0, 0.5, 1.0, 1.5, 2.0] {
        let x = MARGIN + (height / HIGH * ABOVE as f64) as i64;
        canvas.fill(x, legend + 12, 1, 4, INK);
        let x = x.clamp(MARGIN + 4, MARGIN + ABOVE - 11);
        canvas.write_at(x, legend + 18, &format!("{height}{}", if height == HIGH { " m" } else { "" }), INK);
    }
}

fn strip_of(canvas: &mut Canvas, y: i64, width: i64, color: impl Fn(f64) -> Color) {
    for x in 0..width {
        canvas.fill(MARGIN + x, y, 1, 12, color(x as f64 / width as f64));
    }
}

/// Where a range stands between the nearest and the farthest, by its logarithm.
fn share_of(range: f64) -> f64 {
    (range.max(NEAR) / NEAR).ln() / (f64::from(RANGE) / NEAR).ln()
}

fn range_at(share: f64) -> f64 {
    NEAR * (f64::from(RANGE) / NEAR).powf(share)
}

/// Near is bright.
fn by_range(range: f64) -> Color {
    ramp(1.0 - share_of(range))
}

/// A colour between the ends of the ramp, 0 and 1.
fn ramp(share: f64) -> Color {
    let at = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let below = (at as usize).min(RAMP.len() - 2);
    let part = at - below as f64;
    [0, 1, 2].map(|channel| {
        let [low, high] = [RAMP[below][channel], RAMP[below + 1][channel]].map(f64::from);
        (low + part * (high - low)).round() as u8
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn luma(color: Color) -> f64 {
        0.2126 * f64::from(color[0]) + 0.7152 * f64::from(color[1]) + 0.0722 * f64::from(color[2])
    }

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let shades = [0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 9.9].map(|range| luma(by_range(range)));
        assert!(shades.windows(2).all(|pair| pair[0] >= pair[1]) && shades[0] > shades[6] + 100.0, "{shades:?}");
        assert_eq!((ramp(-1.0), ramp(1.0)), (RAMP[0], RAMP[8]));
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

    /// A thing ahead of the robot is above the middle of the picture, one on its left on the left.
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
        // 72 pixels a metre.
        let middle = canvas.width / 2;
        let centre = empty.height - 46 - 20 - 360;
        assert_eq!((x, y), (middle - 72, centre - 144));
    }

    #[test]
    fn what_is_no_picture_is_none() {
        assert!(lidar(&[1.0; 7], None).is_none());
        assert!(camera(&Image { width: 2, height: 2, rgb: vec![0; 11] }).is_none());
        let twice = camera(&Image { width: 2, height: 1, rgb: vec![0; 6] }).unwrap();
        assert_eq!((twice.width, twice.height), (4, 2));
    }
}
