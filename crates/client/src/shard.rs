//! Shards: an evaluation whose episodes several processes share, each playing every N-th of one list.

use std::fmt;
use std::io;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Largest number of shards.
const MAX_SHARDS: usize = 10_000;
/// Variable with the number of shards, where a scheduler gives a process its index alone.
const COUNT: &str = "FIATLUX_SHARDS";
/// Largest record of a shard, bytes: 10,000 seeds of 20 digits take 220,000.
const MAX_RECORD_BYTES: u64 = 1 << 20;
/// Largest number of episodes in a record: each is looked for.
const MAX_RECORD_EPISODES: usize = 1_000_000;

/// Part K of N of a list of episodes: the K-th, and every N-th after it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    /// From 1 to `of`.
    part: usize,
    of: usize,
}

impl Shard {
    /// Part `part` of `of`, from 1 on; `None` if there is no such part, or more than 10,000 of them.
    pub fn new(part: usize, of: usize) -> Option<Self> {
        ((1..=of).contains(&part) && of <= MAX_SHARDS).then_some(Self { part, of })
    }

    /// True if the episode with this index in the whole list belongs to it.
    pub fn has(self, index: usize) -> bool {
        index % self.of == self.part - 1
    }

    /// The part that has the episode with this index.
    pub fn with(self, index: usize) -> Self {
        Self { part: index % self.of + 1, of: self.of }
    }

    /// A name for files and servers of this shard: `NAME-2of4`.
    pub fn name(self, name: &str) -> String {
        format!("{name}-{}of{}", self.part, self.of)
    }

    /// The shard of this process by the variables of its scheduler.
    fn of_scheduler(read: impl Fn(&str) -> Option<String>) -> Result<Self, String> {
        let number = |name: &str| match read(name) {
            None => Ok(None),
            Some(text) => {
                text.trim().parse::<usize>().map(Some).map_err(|_| format!("{name} is '{text}', not a number"))
            }
        };
        let (slurm, kubernetes) = (number("SLURM_ARRAY_TASK_ID")?, number("JOB_COMPLETION_INDEX")?);
        let index = slurm.or(kubernetes).ok_or_else(|| {
            "auto needs an array of Slurm (SLURM_ARRAY_TASK_ID) or an indexed Job of Kubernetes (JOB_COMPLETION_INDEX); give \
             K/N, such as 2/4"
                .to_owned()
        })?;
        if let Some(of) = number(COUNT)? {
            return Self::new(index + 1, of).ok_or_else(|| {
                format!("index {index} is not below {COUNT}={of}; indices go from 0 to one less than it")
            });
        }
        // An array that is submitted again in part would count its own tasks, and share another list.
        let (first, of) = (number("SLURM_ARRAY_TASK_MIN")?, number("SLURM_ARRAY_TASK_COUNT")?);
        let last = number("SLURM_ARRAY_TASK_MAX")?;
        match (first, last, of) {
            (Some(first @ 0..=1), Some(last), Some(of)) if of > 1 && last + 1 == first + of && slurm.is_some() => {
                Self::new((index + 1).saturating_sub(first), of)
                    .ok_or_else(|| format!("there is no task {index} of {of}"))
            }
            _ => Err(format!(
                "auto cannot tell how many shards there are; set {COUNT} to their number and let indices go from 0"
            )),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    /// `2/4`, or `auto` for what Slurm or Kubernetes say.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Self::of_scheduler(|name| std::env::var(name).ok());
        }
        let numbers = text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
        numbers.and_then(|(part, of)| Self::new(part, of)).ok_or_else(|| {
            format!(
                "'{text}' is not a shard; use K/N with K from 1 to N and N up to {MAX_SHARDS}, such as 2/4, or auto"
            )
        })
    }
}

/// The evaluation that a folder has a shard of, so that others know what is missing: the file `shard.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardRecord {
    /// Such as `2/4`.
    pub shard: String,
    /// Ids of all tasks, in order; each is played under all seeds.
    pub tasks: Vec<String>,
    /// All layout seeds, in order.
    pub seeds: Vec<u64>,
    /// The command or call that plays a shard, with `{shard}` and `{out}` in the places of its shard and folder.
    pub again: String,
}

impl ShardRecord {
    /// Name of the file in a shard's folder.
    pub const FILE: &str = "shard.json";

    /// Writes the record into the folder of a shard, or checks that the one there is the same.
    ///
    /// # Errors
    /// The folder has another shard, or cannot be used.
    pub fn keep(&self, folder: &Path) -> io::Result<()> {
        match Self::read(folder)? {
            Some(found) if (&found.shard, &found.tasks, &found.seeds) == (&self.shard, &self.tasks, &self.seeds) => {
                Ok(())
            }
            Some(found) => Err(io::Error::other(format!(
                "it has shard {} of {} tasks in {} rooms, which is another part or evaluation; name another folder",
                found.shard,
                found.tasks.len(),
                found.seeds.len()
            ))),
            None => fiatlux_cli::write_whole(&folder.join(Self::FILE), serde_json::to_string(self)? + "\n"),
        }
    }

    /// Reads the record of a folder; `None` if it has none.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(folder: &Path) -> io::Result<Option<Self>> {
        match fiatlux_files::read_text(&folder.join(Self::FILE), MAX_RECORD_BYTES) {
            Ok(text) => {
                let record: Self = serde_json::from_str(&text)?;
                if record.tasks.len() * record.seeds.len() > MAX_RECORD_EPISODES {
                    return Err(io::Error::other(format!("it names more than {MAX_RECORD_EPISODES} episodes")));
                }
                Ok(Some(record))
            }
            Err(error) if [io::ErrorKind::NotFound, io::ErrorKind::NotADirectory].contains(&error.kind()) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// A command line as [`Self::again`] has it: without the shard and the folder of this process.
    pub fn again(args: impl IntoIterator<Item = String>) -> String {
        let mut words = Vec::new();
        let mut args = args.into_iter();
        while let Some(arg) = args.next() {
            if ["--shard", "--out"].contains(&arg.as_str()) {
                args.next();
            } else if !arg.starts_with("--shard=") && !arg.starts_with("--out=") {
                let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@".contains(c);
                words.push(match !arg.is_empty() && arg.chars().all(is_plain) {
                    true => arg,
                    false => format!("'{}'", arg.replace('\'', r"'\''")),
                });
            }
        }
        words.join(" ") + " --shard {shard} --out {out}"
    }

    /// The shard of this folder.
    pub fn shard(&self) -> Option<Shard> {
        self.shard.parse().ok()
    }

    /// The command or call that plays a shard into a folder.
    pub fn command(&self, shard: Shard, out: &Path) -> String {
        self.again.replace("{shard}", &shard.to_string()).replace("{out}", &out.display().to_string())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn every_episode_is_in_one_shard() {
        for of in 1..=7 {
            let shards: Vec<Shard> = (1..=of).map(|part| format!("{part}/{of}").parse().unwrap()).collect();
            for index in 0..20 {
                let has: Vec<&Shard> = shards.iter().filter(|shard| shard.has(index)).collect();
                assert_eq!(has, [&shards[0].with(index)], "{index} of {of}");
            }
        }
        for bad in ["", "0/4", "5/4", "1/0", "1", "a/b", "-1/4", "1/10001", "1/4/2", " 1/4"] {
            assert!(bad.parse::<Shard>().unwrap_err().contains("such as 2/4"), "{bad}");
        }
    }

    /// Guards that an array submitted again in part does not share another list.
    #[test]
    fn schedulers_say_which_shard_it_is() {
        let auto = |set: &[(&str, &str)]| {
            let read = |name: &str| set.iter().find(|(other, _)| *other == name).map(|(_, value)| (*value).to_owned());
            Shard::of_scheduler(read).map(|shard| shard.to_string())
        };
        let slurm = |id, min, max, count| {
            auto(&[
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ])
        };
        assert_eq!(slurm("0", "0", "15", "16").unwrap(), "1/16");
        assert_eq!(slurm("15", "0", "15", "16").unwrap(), "16/16");
        assert_eq!(slurm("4", "1", "4", "4").unwrap(), "4/4");
        for (id, min, max, count) in
            [("3", "3", "3", "1"), ("3", "3", "7", "2"), ("0", "0", "6", "4"), ("0", "1", "4", "4")]
        {
            assert!(slurm(id, min, max, count).is_err(), "{id} of {min}-{max}, {count}");
        }
        let count = ("FIATLUX_SHARDS", "16");
        assert_eq!(auto(&[("SLURM_ARRAY_TASK_ID", "3"), ("SLURM_ARRAY_TASK_COUNT", "1"), count]).unwrap(), "4/16");
        assert_eq!(auto(&[("JOB_COMPLETION_INDEX", "0"), count]).unwrap(), "1/16");
        for set in [&[("JOB_COMPLETION_INDEX", "16"), count][..], &[("JOB_COMPLETION_INDEX", "0")], &[count]] {
            assert!(auto(set).is_err(), "{set:?}");
        }
        assert!(auto(&[("JOB_COMPLETION_INDEX", "x"), count]).unwrap_err().contains("'x', not a number"));
    }

    #[test]
    fn a_command_plays_another_shard() {
        let again = |line: &str| ShardRecord::again(line.split(' ').map(|word| word.replace('~', " ")));
        assert_eq!(
            again("fiatlux evaluate --shard 1/4 --policy walk --out a --seeds 0..9"),
            "fiatlux evaluate --policy walk --seeds 0..9 --shard {shard} --out {out}"
        );
        assert_eq!(again("x --out=a --shard=1/4 a~'b"), r"x 'a '\''b' --shard {shard} --out {out}");
    }

    #[test]
    fn a_folder_has_one_shard() {
        let folder = std::env::temp_dir().join(format!("fiatlux-shard-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        assert_eq!(ShardRecord::read(&folder).unwrap(), None);
        let record = ShardRecord {
            shard: "2/4".into(),
            tasks: vec!["S05".into()],
            seeds: vec![0, 7],
            again: "play --shard {shard} --out {out}".into(),
        };
        record.keep(&folder).unwrap();
        record.keep(&folder).unwrap();
        assert_eq!(ShardRecord::read(&folder).unwrap().as_ref(), Some(&record));
        assert_eq!(record.command(record.shard().unwrap().with(3), "a".as_ref()), "play --shard 4/4 --out a");
        for other in [
            ShardRecord { shard: "1/4".into(), ..record.clone() },
            ShardRecord { seeds: vec![0], ..record.clone() },
            ShardRecord { tasks: Vec::new(), ..record.clone() },
        ] {
            assert!(other.keep(&folder).unwrap_err().to_string().contains("it has shard 2/4"), "{other:?}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
