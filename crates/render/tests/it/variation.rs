//! Pictures that vary: each part changes them, the same way each time, and none of them where nothing varies.

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_rules::Task;
use fiatlux_world::CameraVariation;

use crate::frames::stage;

const SIZE: [usize; 2] = [48, 32];

/// Nothing varies.
fn none() -> CameraVariation {
    CameraVariation {
        shift: [0.0; 3],
        turn: [0.0; 3],
        angle: 1.0,
        exposure: 0.0,
        noise: 0.0,
        blur: 0.0,
        delay_steps: 0,
        colours: 0.0,
        pattern: 0,
        look: 1,
        stream: (7, 0),
    }
}

#[test]
fn each_part_changes_the_picture_and_repeats() {
    let (scene, row) = stage(Task::S05, 0);
    let (visuals, light) = (Visuals::new(&scene), Lighting::default());
    let mut renderer = Renderer::new(SIZE[0], SIZE[1]);
    let mut draw = |variation: &CameraVariation, name: &str, step: u64| {
        let camera = Camera::head(&scene.robot, &row).unwrap().varied(variation).fitted(SIZE[0], SIZE[1]);
        renderer.render(&visuals, &row, &camera, &light);
        renderer.vary_image(&camera, variation, name, step);
        renderer.image().rgb().to_vec()
    };
    let camera = Camera::head(&scene.robot, &row).unwrap().fitted(SIZE[0], SIZE[1]);
    let plain = Renderer::new(SIZE[0], SIZE[1]).render(&visuals, &row, &camera, &light).rgb().to_vec();
    assert_eq!(draw(&none(), "camera", 3), plain);
    let mut found = vec![plain.clone()];
    let others = [
        CameraVariation { shift: [0.0, 0.05, 0.0], ..none() },
        CameraVariation { turn: [0.0, 0.1, 0.0], ..none() },
        CameraVariation { angle: 1.2, ..none() },
        CameraVariation { exposure: 0.5, ..none() },
        CameraVariation { noise: 4.0, ..none() },
        CameraVariation { blur: 1.0, ..none() },
        CameraVariation { colours: 0.3, ..none() },
    ];
    let patterns = (1..=8).map(|pattern| CameraVariation { pattern, ..none() });
    for variation in others.into_iter().chain(patterns) {
        let varied = draw(&variation, "camera", 3);
        assert_eq!(draw(&variation, "camera", 3), varied, "{variation:?}");
        assert!(!found.contains(&varied), "{variation:?} changes nothing, or as another one does");
        found.push(varied);
    }
    let noisy = CameraVariation { noise: 4.0, ..none() };
    let [one, other, later] =
        [("camera", 3), ("chest_camera", 3), ("camera", 4)].map(|(name, step)| draw(&noisy, name, step));
    assert!(one != other && one != later);
    assert!(one.iter().zip(&plain).all(|(a, b)| a.abs_diff(*b) <= 4));
    let mean = |rgb: &[u8]| rgb.iter().map(|byte| f64::from(*byte)).sum::<f64>() / rgb.len() as f64;
    let blurred = draw(&CameraVariation { blur: 1.5, ..none() }, "camera", 3);
    assert!((mean(&blurred) - mean(&plain)).abs() < 1.0, "a blur keeps the brightness");
    assert!(mean(&draw(&CameraVariation { exposure: 1.0, ..none() }, "camera", 3)) > mean(&plain) + 20.0);
}
