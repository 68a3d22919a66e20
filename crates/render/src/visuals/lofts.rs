//! The outer surfaces of the G1's links, lofted through the sections of `g1_surfaces.toml`.

use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

use nalgebra::{Isometry3, Vector3};
use serde::Deserialize;

use crate::mesh::Mesh;
use crate::paint::Paint;

/// Radii of a section.
const SPOKES: usize = 24;
/// Numbers of a section in the file: place along the axis, the centre's two coordinates, radii; mm.
const COLUMNS: usize = 3 + SPOKES;
const METRES_PER_MM: f64 = 0.001;

/// A link's surface. Its sections rise along the axis.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Loft {
    /// Name of the link, without `left_` or `right_`.
    link: String,
    axis: Axis,
    paint: Coat,
    sections: Vec<[f64; COLUMNS]>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Axis {
    X,
    Y,
    Z,
}

#[derive(Debug, Clone, Copy, Deserialize)]
enum Coat {
    Shell,
    Graphite,
    Joint,
}

#[derive(Debug, Deserialize)]
struct Surfaces {
    loft: Vec<Loft>,
}

#[allow(clippy::expect_used)] // The file is a part of the program; a test reads it.
static LOFTS: LazyLock<Vec<Loft>> = LazyLock::new(|| {
    let surfaces: Surfaces = toml::from_str(include_str!("g1_surfaces.toml")).expect("g1_surfaces.toml is readable");
    surfaces.loft
});

/// Adds the surfaces of a link by its name without its side; `mirror` is 1, or -1 for a link of the right side. False for a
/// link that has none.
pub(super) fn add(mesh: &mut Mesh, link: &str, mirror: f64) -> bool {
    let mut found = false;
    for loft in LOFTS.iter().filter(|loft| loft.link == link) {
        loft.add(mesh, mirror);
        found = true;
    }
    found
}

impl Loft {
    /// The two axes across the loft's own, and the loft's own.
    fn axes(&self) -> [usize; 3] {
        match self.axis {
            Axis::X => [1, 2, 0],
            Axis::Y => [0, 2, 1],
            Axis::Z => [0, 1, 2],
        }
    }

    /// A point of the surface, m, in the frame of the left link.
    fn point(&self, section: usize, spoke: usize) -> Vector3<f64> {
        let [u, v, along] = self.axes();
        let row = &self.sections[section];
        let (angle, radius) = (-PI + TAU * spoke as f64 / SPOKES as f64, row[3 + spoke % SPOKES]);
        let mut point = Vector3::zeros();
        point[along] = row[0];
        point[u] = row[1] + radius * libm::cos(angle);
        point[v] = row[2] + radius * libm::sin(angle);
        point * METRES_PER_MM
    }

    fn center(&self, section: usize) -> Vector3<f64> {
        let [u, v, along] = self.axes();
        let row = &self.sections[section];
        let mut point = Vector3::zeros();
        (point[along], point[u], point[v]) = (row[0], row[1], row[2]);
        point * METRES_PER_MM
    }

    fn add(&self, mesh: &mut Mesh, mirror: f64) {
        let paint = match self.paint {
            Coat::Shell => Paint::Shell,
            Coat::Graphite => Paint::Graphite,
            Coat::Joint => Paint::Joint,
        };
        let last = self.sections.len() - 1;
        let here = Isometry3::identity();
        let left = |p: Vector3<f64>| Vector3::new(p.x, mirror * p.y, p.z);
        // Going round by rising angle is counter-clockwise about z and x, and clockwise about y; a mirror turns it over.
        let inside_out = matches!(self.axis, Axis::Y) != (mirror < 0.0);
        let quad = |mesh: &mut Mesh, [a, b, c, d]: [u32; 4]| {
            mesh.quad(if inside_out { [d, c, b, a] } else { [a, b, c, d] }, paint);
        };
        let mut below: Vec<u32> = Vec::new();
        for section in 0..=last {
            let ring: Vec<u32> = (0..SPOKES)
                .map(|spoke| {
                    let around = self.point(section, spoke + 1) - self.point(section, spoke + SPOKES - 1);
                    let up = self.point((section + 1).min(last), spoke) - self.point(section.saturating_sub(1), spoke);
                    let outwards = around.cross(&up) * if matches!(self.axis, Axis::Y) { -1.0 } else { 1.0 };
                    mesh.vertex(&here, left(self.point(section, spoke)), left(outwards))
                })
                .collect();
            for spoke in 0..below.len() {
                let next = (spoke + 1) % SPOKES;
                quad(mesh, [below[spoke], below[next], ring[next], ring[spoke]]);
            }
            below = ring;
        }
        let along = self.axes()[2];
        for (section, side) in [(0, -1.0), (last, 1.0)] {
            let mut outwards = Vector3::zeros();
            outwards[along] = side;
            let middle = mesh.vertex(&here, left(self.center(section)), left(outwards));
            let rim: Vec<u32> =
                (0..SPOKES).map(|spoke| mesh.vertex(&here, left(self.point(section, spoke)), left(outwards))).collect();
            for spoke in 0..SPOKES {
                let next = (spoke + 1) % SPOKES;
                let [a, b] = if side > 0.0 { [spoke, next] } else { [next, spoke] };
                quad(mesh, [middle, rim[a], rim[b], middle]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_robot::Robot;
    use fiatlux_world::ShapeOwner;

    use super::*;
    use crate::mesh::{Detail, Frame};

    /// Every loft encloses a volume with all its triangles looking outwards, on both sides, and is the surface of a link.
    #[test]
    fn lofts_are_solids_of_the_robots_links() -> Result<(), fiatlux_robot::RobotError> {
        let robot = Robot::benchmark()?;
        for loft in LOFTS.iter() {
            let of_robot = ["", "left_"].iter().any(|side| robot.link_index(&format!("{side}{}", loft.link)).is_some());
            assert!(of_robot, "{}", loft.link);
            assert!(loft.sections.windows(2).all(|pair| pair[0][0] < pair[1][0]), "{}: sections must rise", loft.link);
            let volumes = [1.0, -1.0].map(|mirror| {
                let mut mesh = Mesh::new(Frame::World, ShapeOwner::Room, Detail::Fine);
                loft.add(&mut mesh, mirror);
                let corner = |v: u32| Vector3::from(mesh.positions[v as usize].map(f64::from));
                mesh.triangles
                    .iter()
                    .map(|t| t.vertices.map(corner))
                    .map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0)
                    .sum::<f64>()
            });
            assert!(volumes[0] > 1e-5 && volumes[0] < 0.02, "{}: {volumes:?} m3", loft.link);
            assert!((volumes[0] - volumes[1]).abs() < 1e-3 * volumes[0], "{}: {volumes:?} m3", loft.link);
        }
        Ok(())
    }
}
