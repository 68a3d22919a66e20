//! Meshes of the user's own for the robot's links.

mod folder;
mod limits;
mod read;
#[cfg(test)]
mod tests;

use std::path::Path;
use std::sync::Arc;

use data_encoding::HEXLOWER;
use fiatlux_robot::Robot;
use fiatlux_world::ShapeOwner;
use sha2::{Digest, Sha256};

use crate::error::MeshError;
use crate::mesh::surface::Surface;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::Paint;

/// Triangles that a link's mesh has at most in a robot's camera, those of a finger or a hand behind it. What has more is
/// made coarser there: with this many in every link a frame takes less than twice as long as with our own shapes.
const COARSE_TRIANGLES: [usize; 2] = [1000, 300];
/// Links that Unitree's description paints dark, without their side.
const DARK: [&str; 5] = ["pelvis", "logo_link", "head_link", "hip_pitch_link", "ankle_roll_link"];

/// Meshes that are drawn in place of our own shapes for the links of a robot. Constant: one serves any number of scenes.
#[derive(Debug, Clone)]
pub struct RobotMeshes {
    label: String,
    links: Vec<Option<LinkMeshes>>,
}

#[derive(Debug, Clone)]
struct LinkMeshes {
    fine: Arc<Mesh>,
    coarse: Arc<Mesh>,
}

impl RobotMeshes {
    /// Reads a folder with one file a link: STL, binary or ASCII, or Wavefront OBJ, of which only `v` and `f` are read.
    /// Positions are in the link's frame, m.
    ///
    /// A file is named after its link (`left_knee_link.STL`, any case of the ending). Names of Unitree's description are
    /// known too: of `torso_link.STL` and `torso_link_rev_1_0.STL` the later revision counts; `aliases.txt` lists the
    /// others. Files with other names are ignored. A link without a file keeps our own shape; a palm is part of its
    /// hand's base.
    ///
    /// # Errors
    /// [`MeshError`]: a folder or a file that cannot be read, a folder in which no file fits a link, two files for one
    /// link, a file of more than 64 MiB or 500,000 triangles, files of more than 4,000,000 triangles together, and content
    /// that is not a mesh, has a number that is not finite or is not the size of a link in metres.
    pub fn open(folder: impl AsRef<Path>, robot: &Robot) -> Result<Self, MeshError> {
        let files = folder::files(folder.as_ref(), robot)?;
        let mut links = vec![None; robot.links().len()];
        let mut hash = Sha256::new();
        let mut triangles = 0;
        for file in &files {
            let bytes = read::bytes(&file.path)?;
            for part in [file.name.as_bytes(), &bytes] {
                hash.update((part.len() as u64).to_le_bytes());
                hash.update(part);
            }
            let soup = read::triangles(&file.path, file.format, &bytes)?;
            triangles += soup.len();
            if triangles > limits::TOTAL_TRIANGLES {
                let limit = limits::TOTAL_TRIANGLES;
                let problem = format!("with it the folder has more than {limit} triangles; decimate its meshes");
                return Err(MeshError::content(&file.path, problem));
            }
            let surface = Surface::new(&soup);
            if surface.is_empty() {
                let problem = "it has no triangle with an area; export the link's mesh again";
                return Err(MeshError::content(&file.path, problem));
            }
            links[file.link] = Some(LinkMeshes::new(&surface, file.link, robot));
        }
        let hex = HEXLOWER.encode(&hash.finalize());
        Ok(Self { label: format!("meshes:{hex}"), links })
    }

    /// Identity of the meshes: `meshes:` and the SHA-256, hexadecimal, over names and bytes of the files that are used, sorted
    /// by name.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Indices of the links that have a mesh, ascending.
    pub fn links(&self) -> impl Iterator<Item = usize> {
        self.links.iter().enumerate().filter(|(_, meshes)| meshes.is_some()).map(|(link, _)| link)
    }

    pub(crate) fn get(&self, link: usize, detail: Detail) -> Option<Arc<Mesh>> {
        let meshes = self.links.get(link)?.as_ref()?;
        Some(Arc::clone(match detail {
            Detail::Fine => &meshes.fine,
            Detail::Coarse => &meshes.coarse,
        }))
    }

    /// True if the mesh of another link shows this one too: the base of a hand has its palm.
    pub(crate) fn covers(&self, link: usize, robot: &Robot) -> bool {
        let name = robot.links().get(link).and_then(|link| link.name.strip_suffix("_palm"));
        let base = name.and_then(|side| robot.link_index(&format!("{side}_hand_base_link")));
        base.is_some_and(|base| self.get(base, Detail::Fine).is_some())
    }
}

impl LinkMeshes {
    fn new(surface: &Surface, link: usize, robot: &Robot) -> Self {
        let name = &robot.links()[link].name;
        let plain = name.trim_start_matches("left_").trim_start_matches("right_");
        // Beyond the wrist the sensed links are hand and fingers.
        let is_hand = robot.hand_links().contains(&link) && !plain.starts_with("wrist");
        let paint = match plain {
            _ if is_hand => Paint::Hand,
            plain if DARK.contains(&plain) => Paint::Graphite,
            _ => Paint::Shell,
        };
        let mesh = |detail, surface: &Surface| {
            let mut mesh = Mesh::new(Frame::Link(link), ShapeOwner::Robot(link), detail);
            surface.add_to(&mut mesh, paint);
            Arc::new(mesh.finished())
        };
        let coarse = surface.decimated(COARSE_TRIANGLES[usize::from(is_hand)]);
        Self { fine: mesh(Detail::Fine, surface), coarse: mesh(Detail::Coarse, coarse.as_ref().unwrap_or(surface)) }
    }
}
