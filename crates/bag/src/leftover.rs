//! Leftovers of file systems and file managers in folders.

use std::path::Path;

/// True for a file or folder that nobody put there: hidden ones (`._NAME` of macOS, `.nfs...`, `.Trash-1000`, `.snapshot`), the recycle
/// bins of Windows and of network disks and their entries (`$RECYCLE.BIN`, `$I...`, `#recycle`, `@Recycle`, `@eaDir`), the locks of
/// office programs (`~$NAME`), and the folders of disks and archives.
pub fn is_leftover(path: &Path) -> bool {
    const FOLDERS: [&str; 3] = ["lost+found", "System Volume Information", "__MACOSX"];
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(['.', '$', '#', '@', '~']) || FOLDERS.contains(&&*name)
}
