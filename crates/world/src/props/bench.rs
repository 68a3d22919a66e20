use super::{Part, walls};
use crate::config::{BenchConfig, Surfaces};

/// Top, four legs, a beam between the back legs, and the tray on the top.
pub(crate) fn bench(config: &BenchConfig, surfaces: &Surfaces) -> Vec<Part> {
    let material = surfaces.bench.material();
    let [x, y] = config.slab_half;
    let [leg_x, leg_y] = [x - config.leg_inset[0], y - config.leg_inset[1]];
    let [half_x, half_y] = config.leg_half;
    let [beam_low, beam_high] = config.beam_height;
    let frame = config.frame_height;
    let mut parts = vec![Part::cuboid("top", [-x, -y, frame], [x, y, config.surface_height], material)];
    for (name, at_x, at_y) in [
        ("leg_back_left", -leg_x, -leg_y),
        ("leg_back_right", leg_x, -leg_y),
        ("leg_front_left", -leg_x, leg_y),
        ("leg_front_right", leg_x, leg_y),
    ] {
        let (low, high) = ([at_x - half_x, at_y - half_y, 0.0], [at_x + half_x, at_y + half_y, frame]);
        parts.push(Part::cuboid(name, low, high, material));
    }
    let (low, high) = ([-leg_x, -leg_y - half_y, beam_low], [leg_x, -leg_y + half_y, beam_high]);
    parts.push(Part::cuboid("beam", low, high, material));

    let [center_x, center_y] = config.tray_center;
    let [tray_x, tray_y] = config.tray_half;
    let [base, rim] = config.tray_height;
    let (low, high) = ([center_x - tray_x, center_y - tray_y], [center_x + tray_x, center_y + tray_y]);
    let floor = base + config.tray_wall;
    parts.push(Part::cuboid("tray_floor", [low[0], low[1], base], [high[0], high[1], floor], material));
    let inner = [tray_x - config.tray_wall, tray_y - config.tray_wall];
    parts.extend(walls("tray", config.tray_center, inner, config.tray_half, [base, rim], material));
    parts
}
