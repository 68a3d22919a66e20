//! Views, how they share a picture, and the camera of each in each row.

use std::str::FromStr;

use fiatlux_render::framing::{Aim, FOLLOW_ELEVATION, Focus, Spot, best_bearing, corners};
use fiatlux_render::{Camera, Image, Lighting, Renderer, Visuals};
use fiatlux_rules::{Row, Task, errand};
use fiatlux_world::Scene;
use nalgebra::Vector3;

/// Height of the camera of the room over what it looks at, as an angle, and its bearing, rad.
const ROOM_ELEVATION: f64 = 0.55;
const ROOM_BEARING: f64 = -0.80;
/// Distance from the walls to the rim of the view of the room, m.
const ROOM_INSET: f64 = 0.7;
/// Width of an inset's border, pixels.
const BORDER: usize = 2;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum View {
    /// From outside, with the robot and what its task is about in the picture: ladder and lamp, crate or fresh bulb.
    Follow,
    /// The same for what another task is about: of the errand, the one that it has come to.
    FollowAs(Task),
    /// The whole room from above.
    Room,
    Head,
    /// From one point to another, m, world.
    Free {
        /// Where the camera is.
        eye: Vector3<f64>,
        /// The point that it looks at.
        target: Vector3<f64>,
    },
}

impl FromStr for View {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name.trim() {
            "follow" => Ok(View::Follow),
            name if name.starts_with("follow:") => {
                let task = name["follow:".len()..].parse();
                task.map(View::FollowAs).map_err(|_| format!("'{name}' names no task; use follow:S05 and the like"))
            }
            "room" => Ok(View::Room),
            "head" => Ok(View::Head),
            other => Err(format!("there is no view '{other}'; use follow, room or head, or --eye and --target")),
        }
    }
}

/// Size and quality of the pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows of pixels in a picture.
    pub height: usize,
    /// Samples a pixel, each way.
    pub samples: usize,
    /// Shadows soften with distance: for a still, since it takes several times as long.
    pub soft_shadows: bool,
    /// The first fills the picture; the others are insets.
    pub views: Vec<View>,
    /// Vertical field of view, rad; the head camera has its own.
    pub fov: f64,
}

/// A view's part of a picture, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pane {
    pub view: View,
    pub left: usize,
    pub top: usize,
    pub width: usize,
    pub height: usize,
}

impl Pane {
    fn aspect(&self) -> f64 {
        self.width as f64 / self.height as f64
    }
}

impl Picture {
    /// Where each view is.
    pub(super) fn panes(&self) -> Vec<Pane> {
        let (width, height) = (self.width, self.height);
        let edge = (height / 36).max(2);
        let mut top = edge;
        let mut panes = Vec::new();
        for (index, &view) in self.views.iter().enumerate() {
            let square = view == View::Head;
            let pane = if index == 0 {
                let side = width.min(height);
                let [w, h] = if square { [side, side] } else { [width, height] };
                Pane { view, left: (width - w) / 2, top: (height - h) / 2, width: w, height: h }
            } else {
                let h = (height * 3 / 10).max(2);
                let w = if square { h } else { h * width / height }.clamp(2, width);
                let pane = Pane { view, left: (width - w).saturating_sub(edge), top, width: w, height: h };
                top += h + edge;
                pane
            };
            panes.push(pane);
        }
        panes
    }
}

/// Draws all views of a row into one picture.
#[derive(Debug)]
pub(super) struct Composer {
    panes: Vec<Pane>,
    renderers: Vec<Renderer>,
    /// Black, larger than a pane by a border: what insets lie on.
    grounds: Vec<Image>,
    /// Factor by which a view is drawn larger than its pane.
    factor: usize,
    image: Image,
}

impl Composer {
    pub fn new(picture: &Picture) -> Self {
        let panes = picture.panes();
        let samples = picture.samples.max(1);
        let renderer = |pane: &Pane| match picture.soft_shadows {
            true => Renderer::supersampled(pane.width, pane.height, samples),
            false => Renderer::for_people(pane.width * samples, pane.height * samples),
        };
        let ground = |pane: &Pane| Image::black(pane.width + 2 * BORDER, pane.height + 2 * BORDER);
        Self {
            grounds: panes.iter().skip(1).map(ground).collect(),
            renderers: panes.iter().map(renderer).collect(),
            panes,
            factor: if picture.soft_shadows { 1 } else { samples },
            image: Image::black(picture.width, picture.height),
        }
    }

    /// The picture of a row; one camera for each view.
    pub fn draw(&mut self, visuals: &Visuals, row: &Row, cameras: &[Camera], light: &Lighting) -> &Image {
        for (i, (pane, camera)) in self.panes.iter().zip(cameras).enumerate() {
            if let Some(ground) = i.checked_sub(1).and_then(|inset| self.grounds.get(inset)) {
                self.image.paste(ground, pane.left.saturating_sub(BORDER), pane.top.saturating_sub(BORDER));
            }
            let drawn = self.renderers[i].render(visuals, row, camera, light);
            match self.factor {
                1 => self.image.paste(drawn, pane.left, pane.top),
                factor => self.image.paste(&drawn.reduced(factor), pane.left, pane.top),
            }
        }
        &self.image
    }
}

/// The cameras of an episode.
#[derive(Debug)]
pub(super) struct Rig {
    mounts: Vec<Mount>,
}

#[derive(Debug)]
enum Mount {
    Fixed(Camera),
    Path(Aim, Vec<[f64; 3]>),
    Head,
}

/// The episode and robot of a rig.
pub(super) struct Subject<'a> {
    pub scene: &'a Scene,
    pub visuals: &'a Visuals,
    pub light: &'a Lighting,
    pub task: Option<Task>,
    pub spots: &'a [Spot],
    /// Some rows of those that are drawn.
    pub samples: &'a [Row],
    /// Playing speed: how many simulated seconds a second shows.
    pub speed: f64,
}

impl Rig {
    pub fn new(picture: &Picture, subject: &Subject<'_>) -> Self {
        let mount = |pane: Pane| match pane.view {
            View::Head => Mount::Head,
            View::Free { eye, target } => Mount::Fixed(Camera::look_at(eye, target, picture.fov, pane.aspect())),
            View::Room => Mount::Fixed(room(subject, picture.fov, pane.aspect())),
            View::Follow | View::FollowAs(_) => {
                let focus = Focus::of(match pane.view {
                    View::FollowAs(task) => Some(task),
                    _ => subject.task,
                });
                let lens = [picture.fov, pane.aspect()];
                let bearing = best_bearing(subject.visuals, subject.light, subject.samples, focus, lens);
                let aim = Aim::from(bearing, FOLLOW_ELEVATION, picture.fov, pane.aspect());
                let path = aim.path(subject.spots, focus, subject.speed);
                Mount::Path(aim, path)
            }
        };
        Self { mounts: picture.panes().into_iter().map(mount).collect() }
    }

    /// The cameras in a row, which is the one of that index among all rows that can be drawn.
    ///
    /// # Errors
    /// A robot without a head camera.
    pub fn cameras(&self, scene: &Scene, index: usize, row: &Row) -> Result<Vec<Camera>, fiatlux_render::RenderError> {
        let camera = |mount: &Mount| match mount {
            Mount::Fixed(camera) => Ok(camera.clone()),
            Mount::Path(aim, path) => Ok(aim.camera(path.get(index).or(path.last()).copied().unwrap_or_default())),
            Mount::Head => Camera::head(&scene.robot, row),
        };
        self.mounts.iter().map(camera).collect()
    }
}

/// A camera that holds the whole room; in `climb`, which has none, what happens around the ladder.
fn room(subject: &Subject<'_>, fov: f64, aspect: f64) -> Camera {
    let aim = Aim::from(ROOM_BEARING, ROOM_ELEVATION, fov, aspect);
    let config = &subject.scene.config.room;
    let points: Vec<Vector3<f64>> = if subject.scene.world_from_bench.is_some() {
        let [west, east] = config.wall_x;
        let center = Vector3::new(west + east, config.wall_south_y + config.wall_side_y[1], 0.0) / 2.0;
        let half = [east - center.x - ROOM_INSET, config.wall_side_y[1] - center.y - ROOM_INSET, 1.8];
        corners(half).map(|p| center + p).collect()
    } else {
        let scene = subject.scene;
        let ladder = scene.world_from(errand::LADDER).translation.vector;
        let start = scene.layout.robot.position;
        let centers = [ladder, Vector3::new(start.x, start.y, 0.0)];
        centers.into_iter().flat_map(|center| corners([1.2, 1.2, 2.4]).map(move |p| center + p)).collect()
    };
    aim.camera(aim.fit(&points))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn views_by_name() {
        assert_eq!("follow".parse(), Ok(View::Follow));
        assert_eq!("follow:S05".parse(), Ok(View::FollowAs(Task::S05)));
        assert!("follow:S99".parse::<View>().unwrap_err().contains("names no task"));
        assert_eq!(" head".parse(), Ok(View::Head));
        assert!("top".parse::<View>().unwrap_err().starts_with("there is no view 'top'"));
    }

    #[test]
    fn insets_lie_within_the_picture() {
        for [width, height] in [[1280, 720], [720, 1280], [64, 64], [4096, 64]] {
            let views = vec![View::Follow, View::Head, View::Room];
            let picture = Picture { width, height, samples: 1, soft_shadows: false, views, fov: 0.7 };
            for pane in picture.panes() {
                assert!(pane.left + pane.width <= width && pane.top + pane.height <= height, "{pane:?}");
            }
        }
        let head =
            Picture { width: 1280, height: 720, samples: 1, soft_shadows: false, views: vec![View::Head], fov: 0.7 };
        let pane = head.panes()[0];
        assert_eq!([pane.left, pane.top, pane.width, pane.height], [280, 0, 720, 720]);
    }
}
