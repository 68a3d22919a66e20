//! The meshes of a scene for others that draw: what a viewer on a screen needs to show the same things in the same colours.

use fiatlux_world::ShapeOwner;

use crate::Visuals;
use crate::look::Look;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// Frame that a surface moves with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carrier {
    /// Nothing: it stands in the world.
    World,
    /// A thing that can move, by its index in the manifest.
    Thing(usize),
    /// A link of the robot, by link index.
    Link(usize),
}

/// A rigid surface of triangles, in the frame of what carries it.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    mesh: &'a Mesh,
}

impl<'a> Surface<'a> {
    /// Frame that it moves with.
    pub fn carrier(&self) -> Carrier {
        match self.mesh.frame {
            Frame::World => Carrier::World,
            Frame::Thing(thing) => Carrier::Thing(thing),
            Frame::Link(link) => Carrier::Link(link),
        }
    }

    /// Object that it is part of.
    pub fn owner(&self) -> ShapeOwner {
        self.mesh.owner
    }

    /// Positions of the vertices, m.
    pub fn positions(&self) -> &'a [[f32; 3]] {
        &self.mesh.positions
    }

    /// Unit normals of the vertices, outwards.
    pub fn normals(&self) -> &'a [[f32; 3]] {
        &self.mesh.normals
    }

    /// True if it throws a shadow.
    pub fn casts_shadow(&self) -> bool {
        self.mesh.casts
    }

    /// Each triangle: three vertices, counter-clockwise seen from outside, and the index of its paint in [`paints`].
    pub fn triangles(&self) -> impl Iterator<Item = ([u32; 3], usize)> + 'a {
        self.mesh.triangles.iter().map(|triangle| (triangle.vertices, triangle.paint as usize))
    }
}

/// Response of a paint to light.
#[derive(Debug, Clone, PartialEq)]
pub struct PaintLook {
    /// Its name, such as `Aluminium`.
    pub name: String,
    /// Share of the light that it scatters: red, green, blue, linear, 0 to 1.
    pub colour: [f32; 3],
    /// Share of the light that it mirrors when seen head-on, 0 to 1.
    pub mirror: f32,
    /// Sharpness of highlights: the exponent is two to this power.
    pub sharpness: u8,
    /// Light of its own, as a multiple of its colour.
    pub glow: f32,
    /// Takes the tint of the room.
    pub tinted: bool,
    /// Index of the paint that replaces it while the fresh bulb is in the socket: its glass is lit then.
    pub lit: Option<usize>,
}

/// All paints, by the index that triangles name.
pub fn paints() -> Vec<PaintLook> {
    let look = |paint: Paint| {
        let finish = paint.finish(Look::Two);
        PaintLook {
            name: format!("{paint:?}"),
            colour: finish.colour,
            mirror: finish.mirror,
            sharpness: finish.sharpness,
            glow: finish.glow,
            tinted: finish.tinted,
            lit: (paint == Paint::Glass).then_some(Paint::LitGlass as usize),
        }
    };
    Paint::ALL.into_iter().map(look).collect()
}

impl Visuals {
    /// The surfaces that pictures for people are drawn of.
    pub fn surfaces(&self) -> impl Iterator<Item = Surface<'_>> {
        self.meshes(Detail::Fine).iter().map(|mesh| Surface { mesh })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paints_stand_in_the_order_of_their_numbers() {
        for (index, paint) in Paint::ALL.into_iter().enumerate() {
            assert_eq!(paint as usize, index, "{paint:?}");
        }
        let paints = paints();
        let lit: Vec<_> = paints.iter().filter_map(|paint| Some((paint.name.as_str(), paint.lit?))).collect();
        assert_eq!(lit, [("Glass", Paint::LitGlass as usize)]);
    }
}
