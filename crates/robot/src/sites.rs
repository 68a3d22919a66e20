//! Named frames that controllers aim and stand with: palms, soles and fingertips.

use fiatlux_dynamics::Site;
use nalgebra::{Isometry3, Vector3};

use crate::{Robot, RobotIds, Shape};

/// Sides in the order of [`Robot::feet`] and [`Robot::palms`].
const SIDES: [&str; 2] = ["left", "right"];

/// A frame that is fixed to a link.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotSite {
    /// Name of the site, which no other site of the robot has.
    pub name: String,
    /// Index of the link that carries it.
    pub link: usize,
    /// Pose in that link.
    pub link_from_site: Isometry3<f64>,
}

/// The flat underside of a foot.
#[derive(Debug, Clone, PartialEq)]
pub struct Sole {
    /// Its middle, in the axes of the foot's box: x ahead, z up.
    pub site: RobotSite,
    /// Half its length and half its width, m.
    pub half_extents: [f64; 2],
}

impl Sole {
    /// Its corners in the link's frame, m: front left, front right, rear left, rear right.
    pub fn corners(&self) -> [Vector3<f64>; 4] {
        let [x, y] = self.half_extents;
        [[x, y], [x, -y], [-x, y], [-x, -y]]
            .map(|[x, y]| (self.site.link_from_site * nalgebra::Point3::new(x, y, 0.0)).coords)
    }
}

impl Robot {
    /// The soles, left and right, from the boxes of the feet; a foot without a box has none.
    pub fn soles(&self) -> Vec<Sole> {
        let sole = |(&link, side): (&usize, &str)| {
            self.shapes.iter().filter(|shape| shape.link == link).find_map(|shape| {
                let half = shape.geometry.as_cuboid()?;
                let link_from_site = shape.link_from_shape * Isometry3::translation(0.0, 0.0, -half.z);
                let site = RobotSite { name: format!("{side}_sole"), link, link_from_site };
                Some(Sole { site, half_extents: [half.x, half.y] })
            })
        };
        self.feet.iter().zip(SIDES).filter_map(sole).collect()
    }

    /// All sites: both palms (the frames of the rows: the palm's link, its face towards -x), both soles, and the ends of the
    /// fingers that move (`left_index_tip`), whose z axis points out of the finger.
    pub fn sites(&self) -> Vec<RobotSite> {
        let palm = |(&link, side): (&usize, &str)| RobotSite {
            name: format!("{side}_palm"),
            link,
            link_from_site: Isometry3::identity(),
        };
        let mut sites: Vec<RobotSite> = self.palms.iter().zip(SIDES).map(palm).collect();
        sites.extend(self.soles().into_iter().map(|sole| sole.site));
        let is_last =
            |link: usize| self.links[link].joint.is_some() && self.links.iter().all(|other| other.parent != Some(link));
        let fingers = self.shapes.iter().filter(|shape| self.hand_links.contains(&shape.link) && is_last(shape.link));
        sites.extend(fingers.filter_map(|shape| self.tip(shape)));
        sites
    }

    /// The end of a finger's last link, whose shape is called by side and finger.
    fn tip(&self, shape: &Shape) -> Option<RobotSite> {
        let (side, finger) = shape.name.split_once('_')?;
        let side = SIDES.iter().find(|name| side == **name || name[..1].eq_ignore_ascii_case(side))?;
        let finger = finger.split('_').next()?;
        let link_from_site = shape.link_from_shape * shape.far_end()?;
        Some(RobotSite { name: format!("{side}_{finger}_tip"), link: shape.link, link_from_site })
    }
}

impl RobotIds {
    /// The site in the model.
    ///
    /// # Panics
    /// If the robot of the model has no such link.
    pub fn site(&self, site: &RobotSite) -> Site {
        let link = &self.links[site.link];
        Site { body: link.body, body_from_site: link.body_from_link * site.link_from_site }
    }
}
