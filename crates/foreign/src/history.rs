//! Histories that live inside an observation, so that no copy is needed.

/// Drops the oldest frame of a block and appends the newest one. `newest` should have as many numbers as a frame; if it
/// has fewer, the rest keep their values.
pub(crate) fn push(block: &mut [f32], frame: usize, newest: impl Iterator<Item = f64>) {
    block.copy_within(frame.., 0);
    let last = block.len() - frame;
    block[last..].iter_mut().zip(newest).for_each(|(place, number)| *place = number as f32);
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_oldest_frame_comes_first() {
        let mut block = [0.0; 6];
        for frame in [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]] {
            super::push(&mut block, 2, frame.into_iter());
        }
        assert_eq!(block, [3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    }
}
