//! Whole numbers as bytes that gzip makes small.

/// The numbers of rows of this many columns, column by column: each as its difference from the row before, with small
/// numbers of both signs near 0 (0, -1, 1, -2 are 0, 1, 2, 3), first the lowest bytes of all, then the next ones.
pub(crate) fn planes(numbers: &[i32], columns: usize) -> Vec<u8> {
    let mut changes = Vec::with_capacity(numbers.len());
    for column in 0..columns {
        let mut before = 0_i32;
        for now in numbers.iter().skip(column).step_by(columns) {
            let change = now.wrapping_sub(before);
            changes.push(((change << 1) ^ (change >> 31)).to_le_bytes());
            before = *now;
        }
    }
    (0..4).flat_map(|byte| changes.iter().map(move |change| change[byte])).collect()
}
