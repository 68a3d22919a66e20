//! Joints of a robot file that follow others.

use crate::file::CoupleDef;
use crate::refuse::Refuse;
use crate::{Follows, Joint, Link, RobotError};

/// Lets joints follow others, and narrows the range of each leader to the angles that keep its followers within theirs.
pub(crate) fn couple(
    joints: &mut [Joint],
    links: &[Link],
    defs: &[CoupleDef],
    refuse: &Refuse<'_>,
) -> Result<(), RobotError> {
    for (index, def) in defs.iter().enumerate() {
        let part = refuse.part("couple", index, &def.follower);
        let find = |field: &'static str, name: &str| {
            joints.iter().position(|joint| joint.name == name).ok_or_else(|| {
                part.refuse(field, format!("names joint '{name}', which the robot does not have; correct or remove it"))
            })
        };
        let (follower, leader) = (find("follower", &def.follower)?, find("leader", &def.leader)?);
        if joints[follower].follows.is_some() {
            return Err(part.refuse("follower", "follows a joint already; name it once"));
        }
        if let Some(other) = joints.iter().find(|joint| joint.follows.is_some_and(|of| of.leader == follower)) {
            let problem = format!("leads '{}'; let both follow the first one", other.name);
            return Err(part.refuse("follower", problem));
        }
        if let Some(of) = joints[leader].follows {
            let problem = format!("is '{}', which follows '{}'; name that one", def.leader, joints[of.leader].name);
            return Err(part.refuse("leader", problem));
        }
        if !is_above(links, joints[leader].link, joints[follower].link) {
            let problem = format!("is '{}', which does not carry the follower; name a joint above it", def.leader);
            return Err(part.refuse("leader", problem));
        }
        part.finite("ratio", &[def.ratio])?;
        part.finite("offset", &[def.offset])?;
        if def.ratio == 0.0 {
            return Err(part.refuse("ratio", "is 0; give the follower's angle by rad of the leader, or weld it"));
        }
        let limits = [joints[follower].lower, joints[follower].upper].map(|limit| (limit - def.offset) / def.ratio);
        let of_leader = &mut joints[leader];
        let lower = of_leader.lower.max(limits[0].min(limits[1]));
        let upper = of_leader.upper.min(limits[0].max(limits[1]));
        if lower >= upper {
            let problem = format!(
                "with this offset leaves '{}' no range: it goes from {} to {}, and the follower would need {} to {}; correct them",
                def.leader,
                of_leader.lower,
                of_leader.upper,
                limits[0].min(limits[1]),
                limits[0].max(limits[1])
            );
            return Err(part.refuse("ratio", problem));
        }
        (of_leader.lower, of_leader.upper) = (lower, upper);
        joints[follower].follows = Some(Follows { leader, ratio: def.ratio, offset: def.offset });
    }
    Ok(())
}

/// True if a link hangs below another one.
fn is_above(links: &[Link], above: usize, below: usize) -> bool {
    std::iter::successors(links[below].parent, |link| links[*link].parent).any(|link| link == above)
}

/// Refuses a drive of a follower that would pull.
pub(crate) fn check_drives(joints: &[Joint], names: &[&str], refuse: &Refuse<'_>) -> Result<(), RobotError> {
    for (index, name) in names.iter().enumerate() {
        let Some(joint) = joints.iter().find(|joint| joint.name == *name && joint.follows.is_some()) else { continue };
        for (field, value) in [("stiffness", joint.gains.stiffness), ("damping", joint.gains.damping)] {
            if value != 0.0 {
                let problem = format!("is {value}; the joint follows another by [[couple]], so make it 0");
                return Err(refuse.part("joint", index, name).refuse(field, problem));
            }
        }
    }
    Ok(())
}
