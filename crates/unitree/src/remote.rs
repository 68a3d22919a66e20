//! The robot's remote control, as `LowState` carries it.

/// Keys by their bits.
const KEYS: [(&str, u16); 16] = [
    ("R1", 0),
    ("L1", 1),
    ("start", 2),
    ("select", 3),
    ("R2", 4),
    ("L2", 5),
    ("F1", 6),
    ("F2", 7),
    ("A", 8),
    ("B", 9),
    ("X", 10),
    ("Y", 11),
    ("up", 12),
    ("right", 13),
    ("down", 14),
    ("left", 15),
];

/// Keys and sticks that are held.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Remote {
    keys: u16,
    /// Left stick to the right and up, right stick to the right and up: -1 to 1 each.
    pub sticks: [f32; 4],
}

impl Remote {
    /// Reads the field of a state.
    pub fn read(bytes: &[u8; 40]) -> Self {
        let number = |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        Self { keys: u16::from_le_bytes([bytes[2], bytes[3]]), sticks: [number(4), number(20), number(8), number(12)] }
    }

    /// The field of a state in which these keys are held; names that no key has are left out.
    pub fn with_keys(names: &[&str]) -> [u8; 40] {
        let held = KEYS.iter().filter(|(name, _)| names.contains(name));
        let mut bytes = [0; 40];
        bytes[2..4].copy_from_slice(&held.fold(0_u16, |keys, (_, bit)| keys | 1 << bit).to_le_bytes());
        bytes
    }

    /// True while a key is held.
    pub fn holds(&self, name: &str) -> bool {
        KEYS.iter().any(|(key, bit)| *key == name && self.keys >> bit & 1 == 1)
    }

    /// True while a key is held that means to stop at once: B, or select.
    pub fn stops(&self) -> bool {
        self.holds("B") || self.holds("select")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_the_bits_of_the_second_and_third_byte() {
        let bytes = Remote::with_keys(&["A", "left"]);
        assert_eq!(bytes[2..4], [0, 0x81]);
        let remote = Remote::read(&bytes);
        assert!(remote.holds("A") && remote.holds("left") && !remote.holds("B") && !remote.stops());
        assert!(Remote::read(&Remote::with_keys(&["B"])).stops());
        assert!(Remote::read(&Remote::with_keys(&["select"])).stops());
        assert!(!remote.holds("no key"));
    }

    #[test]
    fn sticks_are_floats() {
        let mut bytes = [0; 40];
        for (at, number) in [(4, 0.25_f32), (8, -0.5), (12, 0.75), (20, -1.0)] {
            bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
        }
        assert_eq!(Remote::read(&bytes).sticks, [0.25, -1.0, -0.5, 0.75]);
    }
}
