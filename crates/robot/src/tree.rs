//! Links and joints of a robot file, and the tree that they make.

use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};

use crate::file::{LinkDef, RobotFile};
use crate::kinematics::pose;
use crate::locate::Step;
use crate::refuse::{Part, Refuse};
use crate::{Joint, JointGains, Link, RobotError};

/// Joint between a link and its parent.
struct EdgeDef<'a> {
    /// Entry of `[[joint]]`; `None` for one of `[[fixed]]`.
    joint: Option<usize>,
    part: Part<'a>,
    parent: &'a str,
    child: &'a str,
    parent_from_child: Isometry3<f64>,
}

/// The links, with parents and poses; [`Link::joint`] is the entry in `[[joint]]` until [`joints`] replaces it.
pub(crate) fn links(file: &RobotFile, refuse: &Refuse<'_>) -> Result<Vec<Link>, RobotError> {
    let mut links: Vec<Link> = Vec::new();
    for (index, def) in file.link.iter().enumerate() {
        let part = refuse.part("link", index, &def.name);
        if links.iter().any(|l| l.name == def.name) {
            return Err(part.refuse("name", "is taken; names must be unique"));
        }
        links.push(link(def, &part)?);
    }
    let edges = edges(file, refuse)?;
    let mut above: Vec<Option<usize>> = vec![None; links.len()];
    for (e, def) in edges.iter().enumerate() {
        let find = |field, name: &str| {
            links.iter().position(|l| l.name == name).ok_or_else(|| {
                def.part.refuse(field, format!("names link '{name}', which the file does not have; add or correct it"))
            })
        };
        let (parent, child) = (find("parent", def.parent)?, find("child", def.child)?);
        if above[child].is_some() {
            let problem = format!("is '{}', which is a child already; a link has one parent", def.child);
            return Err(def.part.refuse("child", problem));
        }
        above[child] = Some(e);
        links[child].parent = Some(parent);
        links[child].parent_from_link = def.parent_from_child;
        links[child].joint = def.joint;
    }
    check_tree(&links, |link| above[link].map(|e| &edges[e].part), refuse)?;
    Ok(links)
}

fn link(def: &LinkDef, part: &Part<'_>) -> Result<Link, RobotError> {
    let (mass, com, inertia) = match (def.mass, def.com, def.inertia) {
        (None, None, None) => (0.0, [0.0; 3], [0.0; 6]),
        (Some(mass), Some(com), Some(inertia)) => {
            part.positive("mass", mass)?;
            part.finite("com", &com)?;
            part.finite("inertia", &inertia)?;
            (mass, com, inertia)
        }
        _ => return Err(part.refuse("mass", "must stand with com and inertia; give all three, or none for a frame")),
    };
    let [xx, yy, zz, xy, xz, yz] = inertia;
    let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    if mass > 0.0 {
        let moments = inertia.symmetric_eigenvalues();
        // Published figures are rounded, so the triangle inequality may be missed by a little.
        if !(moments.min() > 0.0 && 2.0 * moments.max() <= moments.sum() + 0.01 * moments.max()) {
            return Err(part.refuse(
                "inertia",
                "is not that of a solid; every moment must be positive and at most the sum of the other two",
            ));
        }
    }
    Ok(Link {
        name: def.name.clone(),
        mass,
        com: com.into(),
        inertia,
        parent: None,
        parent_from_link: Isometry3::identity(),
        joint: None,
    })
}

fn edges<'a>(file: &'a RobotFile, refuse: &Refuse<'a>) -> Result<Vec<EdgeDef<'a>>, RobotError> {
    let mut edges: Vec<EdgeDef<'a>> = Vec::new();
    let joints = file.joint.iter().enumerate().map(|(i, d)| {
        let part = refuse.part("joint", i, &d.name);
        (Some(i), part, &d.name, &d.parent, &d.child, d.xyz, d.rpy)
    });
    let fixed = file.fixed.iter().enumerate().map(|(i, d)| {
        let part = refuse.part("fixed", i, &d.name);
        (None, part, &d.name, &d.parent, &d.child, d.xyz, d.rpy)
    });
    let mut names: Vec<&str> = Vec::new();
    for (joint, part, name, parent, child, xyz, rpy) in joints.chain(fixed) {
        if names.contains(&name.as_str()) {
            return Err(part.refuse("name", "is taken; names must be unique"));
        }
        names.push(name);
        part.finite("xyz", &xyz)?;
        part.finite("rpy", &rpy)?;
        edges.push(EdgeDef { joint, part, parent, child, parent_from_child: pose(xyz, rpy) });
    }
    Ok(edges)
}

/// One root, no cycle, parents above their children, and something to weigh in every body.
fn check_tree<'a>(
    links: &[Link],
    edge_above: impl Fn(usize) -> Option<&'a Part<'a>>,
    refuse: &Refuse<'_>,
) -> Result<(), RobotError> {
    for start in 0..links.len() {
        let mut at = start;
        for _ in 0..links.len() {
            let Some(parent) = links[at].parent else { break };
            at = parent;
        }
        if let (Some(_), Some(edge)) = (links[at].parent, edge_above(at)) {
            let problem =
                format!("closes a cycle through link '{}'; a robot is a tree, so hang it elsewhere", links[at].name);
            return Err(edge.refuse("parent", problem));
        }
    }
    let mut roots = links.iter().enumerate().filter(|(_, l)| l.parent.is_none());
    let Some((_, root)) = roots.next() else {
        return Err(refuse.at(&[Step::Key("link")], "link", "is empty; a robot has at least one link".into()));
    };
    if let Some((index, other)) = roots.next() {
        let problem =
            format!("is a second root next to '{}'; make it the child of a [[joint]] or [[fixed]]", root.name);
        return Err(refuse.part("link", index, &other.name).refuse("name", problem));
    }
    let mut weighs = vec![false; links.len()];
    let mut body = vec![0; links.len()];
    for (index, link) in links.iter().enumerate() {
        if let Some(parent) = link.parent {
            if parent > index {
                let problem = format!("stands above its parent '{}'; move it below", links[parent].name);
                return Err(refuse.part("link", index, &link.name).refuse("name", problem));
            }
            body[index] = if link.joint.is_some() { index } else { body[parent] };
        }
        weighs[body[index]] |= link.mass > 0.0;
    }
    for (index, link) in links.iter().enumerate() {
        if body[index] == index && !weighs[index] {
            let problem = "is missing here and in all links fixed to it; a link that moves needs one";
            return Err(refuse.part("link", index, &link.name).refuse("mass", problem));
        }
    }
    Ok(())
}

/// The joints in the order of `joint_order`, and the links with their final joint indices.
pub(crate) fn joints(
    file: &RobotFile,
    mut links: Vec<Link>,
    refuse: &Refuse<'_>,
) -> Result<(Vec<Joint>, Vec<Link>), RobotError> {
    let names: Vec<&str> = file.joint.iter().map(|j| j.name.as_str()).collect();
    let mut order = Vec::new();
    for (i, name) in file.joint_order.iter().enumerate() {
        let path = [Step::Key("joint_order"), Step::Index(i)];
        let index = refuse.find(&names, name, "joint", "joint_order", &path)?;
        if order.contains(&index) {
            return Err(refuse.at(&path, "joint_order", format!("names joint '{name}' twice; name each joint once")));
        }
        order.push(index);
    }
    let mut joints: Vec<Option<Joint>> = vec![None; file.joint.len()];
    for (index, def) in file.joint.iter().enumerate() {
        let part = refuse.part("joint", index, &def.name);
        let Some(position) = order.iter().position(|&o| o == index) else {
            return Err(part.refuse("name", "is missing in joint_order; add it there"));
        };
        let Some(link) = links.iter().position(|l| l.name == def.child) else { continue };
        links[link].joint = Some(position);
        part.finite("axis", &def.axis)?;
        let axis = Vector3::from(def.axis);
        if (axis.norm() - 1.0).abs() > 1e-3 {
            return Err(part.refuse("axis", format!("has length {}; it must be a unit vector", axis.norm())));
        }
        part.finite("lower", &[def.lower])?;
        part.finite("upper", &[def.upper])?;
        if def.lower >= def.upper {
            return Err(part.refuse("lower", format!("is {}, it must be below upper, {}", def.lower, def.upper)));
        }
        part.positive("effort_limit", def.effort_limit)?;
        if let Some(speed_limit) = def.speed_limit {
            part.positive("speed_limit", speed_limit)?;
        }
        part.not_negative("stiffness", def.stiffness)?;
        part.not_negative("damping", def.damping)?;
        part.not_negative("armature", def.armature)?;
        joints[position] = Some(Joint {
            name: def.name.clone(),
            link,
            axis: UnitVector3::new_normalize(axis),
            lower: def.lower,
            upper: def.upper,
            gains: JointGains {
                stiffness: def.stiffness,
                damping: def.damping,
                effort_limit: def.effort_limit,
                speed_limit: def.speed_limit.unwrap_or(f64::INFINITY),
                armature: def.armature,
            },
            follows: None,
        });
    }
    Ok((joints.into_iter().flatten().collect(), links))
}
