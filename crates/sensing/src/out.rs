//! Places for a sensor's numbers.

/// Where a sensor's numbers go.
pub(crate) struct Out<'a> {
    places: Places<'a>,
    scale: f64,
}

enum Places<'a> {
    /// A buffer of the caller's.
    Slice(std::slice::IterMut<'a, f32>),
    /// A message's own list.
    List(&'a mut Vec<f32>),
    /// A picture of the caller's.
    Bytes(&'a mut [u8]),
}

impl<'a> Out<'a> {
    /// Numbers that do not fit are left out.
    pub fn slice(numbers: &'a mut [f32]) -> Self {
        Self { places: Places::Slice(numbers.iter_mut()), scale: 1.0 }
    }

    pub fn list(numbers: &'a mut Vec<f32>) -> Self {
        Self { places: Places::List(numbers), scale: 1.0 }
    }

    /// For numbers from 0 to 255; those that do not fit are left out.
    pub fn bytes(bytes: &'a mut [u8]) -> Self {
        Self { places: Places::Bytes(bytes), scale: 1.0 }
    }

    /// Room for a whole picture of so many bytes, for whoever writes them all; `None` where there is no such room.
    pub fn picture(&mut self, length: usize) -> Option<&mut [u8]> {
        match &mut self.places {
            Places::Bytes(bytes) if bytes.len() == length => Some(std::mem::take(bytes)),
            _ => None,
        }
    }

    /// Multiplies the numbers to come.
    pub fn set_scale(&mut self, scale: f64) {
        self.scale = scale;
    }

    pub fn put(&mut self, number: f64) {
        let number = (number * self.scale) as f32;
        match &mut self.places {
            Places::Slice(places) => {
                if let Some(place) = places.next() {
                    *place = number;
                }
            }
            Places::List(list) => list.push(number),
            Places::Bytes(bytes) => {
                if let Some((place, rest)) = std::mem::take(bytes).split_first_mut() {
                    // Saturates.
                    *place = number as u8;
                    *bytes = rest;
                }
            }
        }
    }

    pub fn extend<'n>(&mut self, numbers: impl IntoIterator<Item = &'n f64>) {
        numbers.into_iter().for_each(|number| self.put(*number));
    }

    pub fn extend_bytes(&mut self, numbers: &[u8]) {
        numbers.iter().for_each(|number| self.put(f64::from(*number)));
    }

    pub fn extend_singles(&mut self, numbers: &[f32]) {
        numbers.iter().for_each(|number| self.put(f64::from(*number)));
    }
}
