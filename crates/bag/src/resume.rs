//! Continues an unfinished bag.

use std::fs::File;
use std::path::Path;

use fiatlux_proto::v3::EpisodeHeader;

use crate::{Bag, BagError, BagWriter, part_of, topic};

pub struct Resumed {
    /// Appends the rows that follow the last one that was kept.
    pub writer: BagWriter,
    pub header: EpisodeHeader,
}

impl BagWriter {
    /// Continues `NAME.mcap.part` of the bag `path`: its complete rows go into a new file of that name, chunk for chunk
    /// as if recording had never stopped. [`BagWriter::next_step`] is the next row's step. The old file stays until the
    /// new one is complete.
    pub fn resume(path: &Path) -> Result<Resumed, BagError> {
        let part = part_of(path);
        let bag = Bag::open(&part)?;
        let mut new = part.clone().into_os_string();
        new.push(".new");
        let new = Path::new(&new);
        let file = File::create(new).map_err(BagError::io("make", new))?;
        let mut writer = Self::start(path, new.into(), file, bag.header(), false)?;
        copy_rows(&bag, &mut writer)?;
        writer.forget_row();
        writer.rename_part(part)?;
        Ok(Resumed { writer, header: bag.header().clone() })
    }
}

/// Copies messages in the file's order: the other topics of a row come before its state.
fn copy_rows(bag: &Bag, writer: &mut BagWriter) -> Result<(), BagError> {
    let mut reader = bag.reader()?;
    for chunk in bag.chunks() {
        reader.start(chunk)?;
        reader.find(|found| {
            if found.topic != topic::RESULT {
                writer.message(found.topic, found.step, found.bytes)?;
            }
            Ok(None::<()>)
        })?;
    }
    Ok(())
}
