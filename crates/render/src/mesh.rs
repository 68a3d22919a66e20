//! Triangle meshes.

mod decimate;
pub(crate) mod solids;
pub(crate) mod surface;

use fiatlux_world::ShapeOwner;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::paint::Paint;

/// Frame that a mesh moves with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Frame {
    World,
    /// A thing of the manifest that can move.
    Thing(usize),
    Link(usize),
}

/// Three vertices, counter-clockwise seen from outside.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    pub vertices: [u32; 3],
    pub paint: Paint,
}

impl Triangle {
    #[inline(always)]
    pub(crate) fn indices(&self) -> [usize; 3] {
        let [a, b, c] = self.vertices;
        [a as usize, b as usize, c as usize]
    }

    /// Its paint; the bulb's glass has another one while the bulb burns.
    #[inline(always)]
    pub(crate) fn seen_paint(&self, lit_bulb: bool) -> Paint {
        if lit_bulb && self.paint == Paint::Glass { Paint::LitGlass } else { self.paint }
    }
}

/// Fineness with which round things are cut into triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Detail {
    /// For people to look at.
    Fine,
    /// For a robot's camera and for shadows.
    Coarse,
}

/// A rigid surface of triangles.
#[derive(Debug, Clone)]
pub(crate) struct Mesh {
    detail: Detail,
    pub frame: Frame,
    pub owner: ShapeOwner,
    pub positions: Vec<[f32; 3]>,
    /// The positions by axis: x, y and z of all vertices; made by [`Mesh::finished`].
    pub columns: [Vec<f32>; 3],
    pub normals: Vec<[f32; 3]>,
    pub triangles: Vec<Triangle>,
    /// Number of triangles, from the first, that throw a shadow; the others are the insides of a surface that is not closed.
    pub casting: usize,
    /// Centre of the bounding sphere, m; `radius` is its radius.
    pub center: Vector3<f64>,
    pub radius: f64,
    /// It throws a shadow.
    pub casts: bool,
}

impl Mesh {
    pub(crate) fn new(frame: Frame, owner: ShapeOwner, detail: Detail) -> Self {
        Self {
            detail,
            frame,
            owner,
            positions: Vec::new(),
            columns: [const { Vec::new() }; 3],
            normals: Vec::new(),
            triangles: Vec::new(),
            casting: usize::MAX,
            center: Vector3::zeros(),
            radius: 0.0,
            casts: !matches!(owner, ShapeOwner::Floor | ShapeOwner::Room),
        }
    }

    /// Segments around something that deserves `fine` ones when looked at closely.
    fn segments(&self, fine: u32) -> u32 {
        match self.detail {
            Detail::Fine => fine,
            Detail::Coarse => (fine * 2 / 5).max(6),
        }
    }

    /// Adds a vertex and returns its index.
    pub(crate) fn vertex(&mut self, pose: &Isometry3<f64>, position: Vector3<f64>, normal: Vector3<f64>) -> u32 {
        let p = pose * Point3::from(position);
        let n = pose.rotation * normal.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        self.positions.push([p.x as f32, p.y as f32, p.z as f32]);
        self.normals.push([n.x as f32, n.y as f32, n.z as f32]);
        self.positions.len() as u32 - 1
    }

    pub(crate) fn triangle(&mut self, vertices: [u32; 3], paint: Paint) {
        let [a, b, c] = vertices;
        if a != b && b != c && c != a {
            self.triangles.push(Triangle { vertices, paint });
        }
    }

    /// Four vertices, counter-clockwise seen from outside.
    pub(crate) fn quad(&mut self, [a, b, c, d]: [u32; 4], paint: Paint) {
        self.triangle([a, b, c], paint);
        self.triangle([a, c, d], paint);
    }

    /// The triangles that throw a shadow.
    pub(crate) fn casters(&self) -> &[Triangle] {
        &self.triangles[..self.casting.min(self.triangles.len())]
    }

    /// Sets the bounding sphere and the positions by axis; to be called when all parts are in.
    pub(crate) fn finished(mut self) -> Self {
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = -low;
        for p in &self.positions {
            let p = Vector3::from(p.map(f64::from));
            (low, high) = (low.inf(&p), high.sup(&p));
        }
        if !self.positions.is_empty() {
            self.center = (low + high) / 2.0;
            self.radius = (high - low).norm() / 2.0;
        }
        self.columns = [0, 1, 2].map(|axis| self.positions.iter().map(|position| position[axis]).collect());
        self
    }
}
