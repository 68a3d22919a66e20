//! Looks of paints, eight pixels at a time.

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
    pub sharpest: u8,
    pub has_floor: bool,
    pub has_wall: bool,
    pub has_mirror: bool,
}

impl Looks {
    #[inline(always)]
    pub fn set(&mut self, k: usize, finish: &Finish, paint: Paint, light: &PreparedLight) {
        let (is_floor, is_wall) = (paint == Paint::Floor, paint == Paint::Wall);
        for axis in 0..3 {
            self.colour[axis][k] = finish.colour[axis];
            self.tint[axis][k] = if finish.tinted { light.room_tint[axis] } else { 1.0 };
        }
        (self.floor[k], self.wall[k]) = (f32::from(u8::from(is_floor)), f32::from(u8::from(is_wall)));
        (self.has_floor, self.has_wall) = (self.has_floor | is_floor, self.has_wall | is_wall);
        (self.mirror[k], self.glow[k]) = (finish.mirror, finish.glow);
        self.has_mirror |= finish.mirror > 0.0;
        self.sharpness[k] = f32::from(finish.sharpness);
        self.power[k] = f32::from(1_u16 << finish.sharpness);
        self.sharpest = self.sharpest.max(finish.sharpness);
    }
}
