//! The mappings that come with this program.

use crate::Dialect;

const SHIPPED: [(&str, &str); 8] = [
    ("unitree_g1", include_str!("../../mappings/unitree_g1.toml")),
    ("real_g1", include_str!("../../mappings/real_g1.toml")),
    ("unitree_g1_sonic", include_str!("../../mappings/unitree_g1_sonic.toml")),
    ("openpi_g1", include_str!("../../mappings/openpi_g1.toml")),
    ("behavior_g1", include_str!("../../mappings/behavior_g1.toml")),
    ("roboarena_g1", include_str!("../../mappings/roboarena_g1.toml")),
    ("lerobot_g1", include_str!("../../mappings/lerobot_g1.toml")),
    ("lerobot_g1_hand", include_str!("../../mappings/lerobot_g1_hand.toml")),
];

/// Names of the mappings that come with this program, for [`Mapping::open`](crate::Mapping::open).
pub fn shipped_names() -> Vec<&'static str> {
    SHIPPED.map(|(name, _)| name).to_vec()
}

/// The mapping to use for a dialect if the user names none.
pub fn default_mapping(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::Gr00t | Dialect::Gr00tFlat => "unitree_g1",
        Dialect::Gr00tSonic => "unitree_g1_sonic",
        Dialect::Openpi => "openpi_g1",
        Dialect::Behavior => "behavior_g1",
        Dialect::Roboarena => "roboarena_g1",
    }
}

pub(super) fn text(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}
