//! Hosted seeds that servers without a common folder share.

use fiatlux_access::RecorderKey;
use fiatlux_proto::Message as _;
use fiatlux_proto::v3::RunSpec;

use crate::server::info::VERSION;

/// The hosted seeds of servers that share runs, but no folder: they follow from a key that all of them have, and each episode belongs to
/// one of them. So none is played twice, and what one server shows of its episodes says nothing about those of another.
#[derive(Debug, Clone)]
pub struct SharedSeeds {
    pub key: RecorderKey,
    /// Names of the servers, sorted.
    pub group: Vec<String>,
}

impl SharedSeeds {
    /// Numbers for the seeds of a run, as `register::episodes` takes them. A run with another key, spec or group has others: nobody learns
    /// them from a run that has the same name.
    pub(super) fn seeds(&self, run: &str, key_sha256: &str, spec: &RunSpec) -> impl FnMut() -> u64 {
        let (key, group) = (self.key.clone(), self.group.join(","));
        let mut of = [run, key_sha256, &group, VERSION].join("\0").into_bytes();
        of.push(0);
        of.extend(spec.encode_to_vec());
        let mut count = 0;
        move || {
            count += 1;
            key.number(&of, count)
        }
    }
}
