//! Colours and finishes.

use crate::look::Look;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Paint {
    Floor,
    Wall,
    Ceiling,
    Wood,
    Steel,
    Tray,
    Crate,
    CrateTrim,
    Socket,
    Brass,
    Aluminium,
    Tread,
    Rubber,
    Accent,
    Shell,
    Graphite,
    Joint,
    Hand,
    Visor,
    Light,
    Cap,
    Tip,
    Glass,
    SpentGlass,
    LitGlass,
}

/// Response of a paint to light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Finish {
    /// Share of the light that it scatters, linear.
    pub colour: [f32; 3],
    /// Share of the light that it mirrors when seen head-on.
    pub mirror: f32,
    /// Sharpness of the key light's highlight: the exponent is two to this power.
    pub sharpness: u8,
    /// Light of its own, linear.
    pub glow: f32,
    /// Takes the room's tint.
    pub tinted: bool,
}

impl Paint {
    pub(crate) const ALL: [Paint; 25] = [
        Paint::Floor,
        Paint::Wall,
        Paint::Ceiling,
        Paint::Wood,
        Paint::Steel,
        Paint::Tray,
        Paint::Crate,
        Paint::CrateTrim,
        Paint::Socket,
        Paint::Brass,
        Paint::Aluminium,
        Paint::Tread,
        Paint::Rubber,
        Paint::Accent,
        Paint::Shell,
        Paint::Graphite,
        Paint::Joint,
        Paint::Hand,
        Paint::Visor,
        Paint::Light,
        Paint::Cap,
        Paint::Tip,
        Paint::Glass,
        Paint::SpentGlass,
        Paint::LitGlass,
    ];

    /// True if a flat surface of it at that height (m) looks the same all around but for shadows.
    pub(crate) fn is_plain(self, finishes: &[Finish], height: f32) -> bool {
        let patterned = self == Paint::Floor || (self == Paint::Wall && height < 0.3);
        !patterned && finishes[self as usize].mirror == 0.0
    }

    pub(crate) fn finish(self, look: Look) -> Finish {
        // sRGB colour, mirror, sharpness, glow.
        let (rgb, mirror, sharpness, glow) = match self {
            Paint::Aluminium if look == Look::Two => ([112, 118, 126], 0.55, 6, 0.0),
            Paint::Steel if look == Look::Two => ([92, 97, 104], 0.09, 5, 0.0),
            Paint::Floor => ([136, 137, 140], 0.0, 0, 0.0),
            Paint::Wall => ([222, 217, 208], 0.0, 0, 0.0),
            Paint::Ceiling => ([226, 226, 222], 0.0, 0, 0.0),
            Paint::Wood => ([186, 138, 92], 0.0, 0, 0.0),
            Paint::Steel => ([92, 97, 104], 0.03, 4, 0.0),
            Paint::Tray => ([64, 118, 158], 0.0, 0, 0.0),
            Paint::Crate => ([238, 178, 32], 0.0, 0, 0.0),
            Paint::CrateTrim => ([205, 140, 18], 0.0, 0, 0.0),
            Paint::Socket => ([124, 130, 138], 0.04, 5, 0.0),
            Paint::Brass => ([150, 120, 66], 0.20, 4, 0.0),
            Paint::Aluminium => ([150, 158, 168], 0.18, 5, 0.0),
            Paint::Tread => ([56, 60, 66], 0.02, 3, 0.0),
            Paint::Rubber => ([34, 35, 37], 0.015, 3, 0.0),
            Paint::Accent => ([226, 92, 38], 0.03, 4, 0.0),
            Paint::Shell => ([208, 210, 213], 0.04, 5, 0.0),
            Paint::Graphite => ([88, 92, 99], 0.04, 4, 0.0),
            Paint::Joint => ([42, 44, 48], 0.03, 4, 0.0),
            Paint::Hand => ([58, 60, 65], 0.03, 4, 0.0),
            Paint::Visor => ([14, 16, 20], 0.08, 6, 0.0),
            Paint::Light => ([150, 220, 255], 0.0, 0, 1.2),
            Paint::Cap => ([176, 172, 160], 0.30, 4, 0.0),
            Paint::Tip => ([60, 58, 54], 0.05, 4, 0.0),
            Paint::Glass => ([255, 233, 184], 0.05, 6, 0.16),
            Paint::SpentGlass => ([150, 128, 104], 0.06, 6, 0.0),
            Paint::LitGlass => ([255, 216, 148], 0.02, 6, 2.2),
        };
        let tinted = matches!(self, Paint::Floor | Paint::Wall | Paint::Ceiling);
        Finish { colour: rgb.map(linear), mirror, sharpness, glow, tinted }
    }
}

/// Linear value of an 8-bit sRGB one.
pub(crate) fn linear(srgb: u8) -> f32 {
    let c = f64::from(srgb) / 255.0;
    (if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) }) as f32
}

/// 8-bit sRGB value of a linear one.
pub(crate) fn encode(linear: f64) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let srgb = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * libm::pow(c, 1.0 / 2.4) - 0.055 };
    (srgb * 255.0 + 0.5) as u8
}
