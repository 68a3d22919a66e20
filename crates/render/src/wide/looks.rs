//! Looks of paints, eight pixels at a time.

use std::ops::Range;

use crate::lighting::PreparedLight;
use crate::paint::{Finish, Paint};
use crate::raster::LANES;

/// Looks of the paints of eight pixels.
#[derive(Default)]
pub(super) struct Looks {
    pub colour: [[f32; LANES]; 3],
    pub tint: [[f32; LANES]; 3],
    pub mirror: [f32; LANES],
    pub sharpness: [f32; LANES],
    /// Two to the power of the sharpness.
    pub power: [f32; LANES],
    pub glow: [f32; LANES],
    pub floor: [f32; LANES],
    pub wall: [f32; LANES],
}

impl Looks {
    #[inline(always)]
    pub fn of(paints: [Paint; LANES], finishes: &[Finish], light: &PreparedLight) -> Self {
        let mut looks = Self::default();
        // Most eights are of one paint.
        if paints == [paints[0]; LANES] {
            looks.set(0..LANES, &finishes[paints[0] as usize], paints[0], light);
        } else {
            for (k, paint) in paints.into_iter().enumerate() {
                looks.set(k..k + 1, &finishes[paint as usize], paint, light);
            }
        }
        looks
    }

    #[inline(always)]
    fn set(&mut self, lanes: Range<usize>, finish: &Finish, paint: Paint, light: &PreparedLight) {
        for axis in 0..3 {
            self.colour[axis][lanes.clone()].fill(finish.colour[axis]);
            self.tint[axis][lanes.clone()].fill(if finish.tinted { light.room_tint[axis] } else { 1.0 });
        }
        self.floor[lanes.clone()].fill(f32::from(u8::from(paint == Paint::Floor)));
        self.wall[lanes.clone()].fill(f32::from(u8::from(paint == Paint::Wall)));
        self.mirror[lanes.clone()].fill(finish.mirror);
        self.glow[lanes.clone()].fill(finish.glow);
        self.sharpness[lanes.clone()].fill(f32::from(finish.sharpness));
        self.power[lanes].fill(f32::from(1_u16 << finish.sharpness));
    }

    /// The largest sharpness.
    #[inline(always)]
    pub fn sharpest(&self) -> u8 {
        self.sharpness.iter().fold(0, |most, sharpness| most.max(*sharpness as u8))
    }
}
