//! Leftovers of file systems and file managers in folders.

use std::path::Path;

/// True for a file or folder that nobody put there: hidden ones (`._NAME` of macOS, `.nfs...`, `.Trash-1000`), the recycle bin
/// of Windows and its entries (`$RECYCLE.BIN`, `$I...`), and the folders of disks and archives.
pub(crate) fn is_leftover(path: &Path) -> bool {
    const FOLDERS: [&str; 4] = ["lost+found", "System Volume Information", "__MACOSX", "@eaDir"];
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(['.', '$']) || FOLDERS.contains(&&*name)
}
