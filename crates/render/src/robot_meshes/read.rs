//! Triangles from a file's bytes.

use std::io::{Cursor, Read};
use std::path::Path;

use super::folder::Format;
use super::limits;
use crate::error::MeshError;

/// Corners of a triangle in the link's frame, m.
type Corners = [[f32; 3]; 3];

/// Size of a binary STL file's head, and of each triangle behind it, bytes.
const HEAD: usize = 84;
const RECORD: usize = 50;

/// Content of a file, up to the size that is read.
pub(super) fn bytes(path: &Path) -> Result<Vec<u8>, MeshError> {
    let unreadable = |source| MeshError::Read { path: path.into(), source };
    let mut bytes = Vec::new();
    let file = fiatlux_files::open(path).map_err(unreadable)?;
    file.take(limits::FILE_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > limits::FILE_BYTES {
        let problem = format!("it has more than {} MiB; decimate the mesh", limits::FILE_BYTES >> 20);
        return Err(MeshError::content(path, problem));
    }
    Ok(bytes)
}

/// The triangles of a file, at least one, with finite corners within the size of a link.
pub(super) fn triangles(path: &Path, format: Format, bytes: &[u8]) -> Result<Vec<Corners>, MeshError> {
    let read = match format {
        Format::Stl => stl(bytes),
        Format::Obj => obj(bytes),
    };
    let read = read.and_then(|triangles| check(&triangles).map(|()| triangles));
    read.map_err(|problem| MeshError::content(path, problem))
}

fn check(triangles: &[Corners]) -> Result<(), String> {
    if triangles.is_empty() {
        return Err("it has no triangle; export the link's mesh again".into());
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let mut reach = 0.0_f32;
    for p in triangles.iter().flatten() {
        if p.iter().any(|value| !value.is_finite()) {
            return Err("it has a coordinate that is not finite; export the link's mesh again".into());
        }
        for i in 0..3 {
            (low[i], high[i]) = (low[i].min(p[i]), high[i].max(p[i]));
            reach = reach.max(p[i].abs());
        }
    }
    if reach > limits::REACH {
        return Err(format!(
            "it reaches {reach:.1} m from the link's origin, and a link at most {}; scale it by 0.001 if it is in \
             millimetres, and export it in the link's frame",
            limits::REACH
        ));
    }
    let side = (0..3).map(|i| high[i] - low[i]).fold(0.0, f32::max);
    if side < limits::MIN_SIDE {
        return Err(format!("it is only {side:e} m large; export it in metres"));
    }
    Ok(())
}

fn too_many() -> String {
    format!("it has more than {} triangles; decimate the mesh", limits::TRIANGLES)
}

fn check_lines(bytes: &[u8]) -> Result<(), String> {
    if bytes.split(|byte| *byte == b'\n').any(|line| line.len() > limits::LINE_BYTES) {
        return Err(format!("it has a line of more than {} bytes; export the link's mesh again", limits::LINE_BYTES));
    }
    Ok(())
}

fn stl(bytes: &[u8]) -> Result<Vec<Corners>, String> {
    let count = bytes.get(HEAD - 4..HEAD).and_then(|count| count.try_into().ok()).map(u32::from_le_bytes);
    let size = count.map(|count| HEAD as u64 + RECORD as u64 * u64::from(count));
    // Some programs begin the head of a binary file with `solid`, so its size goes first.
    let text = bytes.trim_ascii_start();
    let is_text = text.starts_with(b"solid") && size != Some(bytes.len() as u64);
    let mut whole = Vec::with_capacity(bytes.len());
    if is_text {
        check_lines(text)?;
        // The name behind it may be missing or in any encoding.
        let body = text.iter().position(|byte| *byte == b'\n').unwrap_or(text.len());
        whole.extend_from_slice(b"solid ");
        whole.extend_from_slice(&text[body..]);
    } else {
        match (count, size) {
            (Some(count), Some(size)) if size > bytes.len() as u64 => {
                let found = bytes.len();
                return Err(format!(
                    "{count} triangles, of which its head speaks, take {size} bytes, and it has {found}: it is cut off or \
                     no STL file; export the link's mesh again"
                ));
            }
            (Some(count), _) if count as usize > limits::TRIANGLES => return Err(too_many()),
            (Some(_), Some(_)) => {
                whole.resize(HEAD - 4, 0);
                whole.extend_from_slice(&bytes[HEAD - 4..]);
            }
            _ => return Err("it is too short for an STL file; export the link's mesh again".into()),
        }
    }
    let wrong = |error: std::io::Error| format!("it is not a whole STL file ({error}); export the link's mesh again");
    let mut cursor = Cursor::new(whole);
    let reader = stl_io::create_stl_reader(&mut cursor).map_err(wrong)?;
    let mut triangles = Vec::new();
    for triangle in reader {
        if triangles.len() >= limits::TRIANGLES {
            return Err(too_many());
        }
        triangles.push(triangle.map_err(wrong)?.vertices.map(Into::into));
    }
    Ok(triangles)
}

/// Positions and faces; a face of more than three corners becomes a fan.
fn obj(bytes: &[u8]) -> Result<Vec<Corners>, String> {
    check_lines(bytes)?;
    let text = std::str::from_utf8(bytes).map_err(|_| "it is not text; export the link's mesh again")?;
    let mut positions: Vec<[f32; 3]> = Vec::new();
    let mut triangles = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let wrong = |what: &str| format!("line {number} {what}; export the link's mesh again");
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let numbers: Option<Vec<f32>> = words.take(3).map(|word| word.parse().ok()).collect();
                let position = numbers.and_then(|numbers| numbers.try_into().ok());
                positions.push(position.ok_or_else(|| wrong("has no position of three numbers"))?);
            }
            Some("f") => {
                let corners: Option<Vec<_>> = words.map(|word| corner(word, &positions)).collect();
                let corners = corners.ok_or_else(|| wrong("names a vertex that is not there"))?;
                for i in 2..corners.len() {
                    if triangles.len() >= limits::TRIANGLES {
                        return Err(too_many());
                    }
                    triangles.push([corners[0], corners[i - 1], corners[i]]);
                }
            }
            _ => {}
        }
    }
    Ok(triangles)
}

/// The position that a face's corner names: counted from 1, or backwards from -1; what follows a slash is not read.
fn corner(word: &str, positions: &[[f32; 3]]) -> Option<[f32; 3]> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let at = if index < 0 { (positions.len() as i64).checked_add(index)? } else { index - 1 };
    positions.get(usize::try_from(at).ok()?).copied()
}
