//! The two forms of a message: CDR on the wire, and the layout of the maker's C structs, which checksums are made of.

use thiserror::Error;

/// Encapsulation header of XCDR1, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];
/// Longest sequence or text that is read: no message of the robot has as much.
const MAX_LENGTH: usize = 4096;
/// Alignment of each of the robot's structs in C, bytes: all hold a `u32` or an `f32`, and none an 8-byte number.
const STRUCT_ALIGNMENT: usize = 4;

/// Why bytes are not the message that their topic says.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum CdrError {
    #[error("the message begins with {0:02x?}, and not with 00 01: it is not XCDR1 in little endian")]
    Encapsulation([u8; 2]),
    #[error("the message of {length} bytes ends too early")]
    Short { length: usize },
    #[error("the message has {rest} bytes too many")]
    Long { rest: usize },
    #[error("the message has a list of {length} entries; at most {MAX_LENGTH} are read")]
    List { length: usize },
    #[error("the message has a text that is not UTF-8 with a zero at its end")]
    Text,
}

/// A part of messages.
pub(crate) trait Part: Sized {
    fn write(&self, to: &mut Writer);
    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError>;
}

/// A message that stands alone.
#[allow(private_bounds)] // The parts are this crate's.
pub trait Message: Part {
    /// Its type's name on the wire.
    const TYPE: &'static str;

    /// The bytes of a sample, encapsulation header included.
    fn to_cdr(&self) -> Vec<u8> {
        let mut writer = Writer { bytes: Vec::new(), pads_structs: false };
        self.write(&mut writer);
        [HEADER.as_slice(), &writer.bytes].concat()
    }

    /// Reads a sample, encapsulation header included. Up to three bytes of padding may follow.
    ///
    /// # Errors
    /// [`CdrError`].
    fn from_cdr(sample: &[u8]) -> Result<Self, CdrError> {
        let (header, bytes) = sample.split_at_checked(HEADER.len()).ok_or(CdrError::Short { length: sample.len() })?;
        // The last two bytes are options, which XCDR1 does not use but to count padding.
        if header[..2] != HEADER[..2] {
            return Err(CdrError::Encapsulation([header[0], header[1]]));
        }
        let mut reader = Reader { bytes, at: 0 };
        let message = Self::read(&mut reader)?;
        match bytes.len() - reader.at {
            0..4 => Ok(message),
            rest => Err(CdrError::Long { rest }),
        }
    }
}

/// The message in the layout of the maker's C struct, little endian, padding zero.
pub(crate) fn c_layout(message: &impl Part) -> Vec<u8> {
    let mut writer = Writer { bytes: Vec::new(), pads_structs: true };
    message.write(&mut writer);
    writer.bytes
}

pub(crate) struct Writer {
    bytes: Vec<u8>,
    pads_structs: bool,
}

impl Writer {
    fn align(&mut self, alignment: usize) {
        self.bytes.resize(self.bytes.len().next_multiple_of(alignment), 0);
    }

    /// A struct begins, or ends.
    pub fn edge(&mut self) {
        if self.pads_structs {
            self.align(STRUCT_ALIGNMENT);
        }
    }

    fn put<const N: usize>(&mut self, number: [u8; N]) {
        self.align(N);
        self.bytes.extend(number);
    }
}

pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        let start = self.at.next_multiple_of(N);
        let number = self.bytes.get(start..start + N).and_then(|number| number.try_into().ok());
        self.at = start + N;
        number.ok_or(CdrError::Short { length: self.bytes.len() })
    }

    fn length(&mut self) -> Result<usize, CdrError> {
        let length = u32::read(self)? as usize;
        if length > MAX_LENGTH { Err(CdrError::List { length }) } else { Ok(length) }
    }
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Part for $number {
            fn write(&self, to: &mut Writer) {
                to.put(self.to_le_bytes());
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
                Ok(Self::from_le_bytes(from.take()?))
            }
        }
    )*};
}
numbers!(u8, i16, i32, u32, i64, f32);

impl Part for bool {
    fn write(&self, to: &mut Writer) {
        u8::from(*self).write(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        Ok(u8::read(from)? != 0)
    }
}

impl<T: Part + Copy + Default, const N: usize> Part for [T; N] {
    fn write(&self, to: &mut Writer) {
        self.iter().for_each(|entry| entry.write(to));
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let mut entries = [T::default(); N];
        for entry in &mut entries {
            *entry = T::read(from)?;
        }
        Ok(entries)
    }
}

impl<T: Part> Part for Vec<T> {
    fn write(&self, to: &mut Writer) {
        (self.len() as u32).write(to);
        self.iter().for_each(|entry| entry.write(to));
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        (0..from.length()?).map(|_| T::read(from)).collect()
    }
}

impl Part for String {
    fn write(&self, to: &mut Writer) {
        let mut bytes = self.clone().into_bytes();
        bytes.push(0);
        bytes.write(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let mut bytes = Vec::<u8>::read(from)?;
        // Some writers leave out the zero of an empty text.
        match bytes.pop() {
            None => Ok(Self::new()),
            Some(0) => Self::from_utf8(bytes).map_err(|_| CdrError::Text),
            Some(_) => Err(CdrError::Text),
        }
    }
}

/// Defines structs, and their order on the wire with them.
macro_rules! parts {
    ($($(#[$of:meta])* $name:ident { $($(#[$about:meta])* $field:ident: $kind:ty,)* })*) => {$(
        $(#[$of])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $($(#[$about])* pub $field: $kind,)*
        }

        impl crate::cdr::Part for $name {
            fn write(&self, to: &mut crate::cdr::Writer) {
                to.edge();
                $(self.$field.write(to);)*
                to.edge();
            }

            fn read(from: &mut crate::cdr::Reader<'_>) -> Result<Self, crate::cdr::CdrError> {
                Ok(Self { $($field: crate::cdr::Part::read(from)?,)* })
            }
        }
    )*};
}
pub(crate) use parts;
