use fiatlux_proto::v3::EpisodeEnd;

use super::*;

const NOW: Duration = Duration::from_secs(100);

fn header(episode: u64) -> EpisodeHeader {
    EpisodeHeader { task: "S01".into(), episode, ..EpisodeHeader::default() }
}

/// StepRecords of one episode, the last with its result.
fn episode(first_seq: u64, episode: u64, rows: u64) -> Vec<StepRecord> {
    let row = |step| StepRecord {
        seq: first_seq + step,
        episode,
        step,
        state: vec![1],
        header: (step == 0).then(|| header(episode)),
        result: (step + 1 == rows).then(EpisodeResult::default),
        ..StepRecord::default()
    };
    (0..rows).map(row).collect()
}

/// What is written, in short: `o` for a new bag, steps, `f` for its end, `c` for a cut.
fn written(track: &mut Track) -> String {
    let short = |write| match write {
        Write::Open(header) => format!("o{}", header.episode),
        Write::Row(truth) => truth.step.to_string(),
        Write::Finish(_) => "f".into(),
        Write::Cut(reason) => {
            assert!(!reason.is_empty());
            "c".into()
        }
    };
    std::iter::from_fn(|| track.next_write()).map(short).collect::<Vec<_>>().join(" ")
}

fn take(track: &mut Track, truths: impl IntoIterator<Item = StepRecord>) {
    truths.into_iter().for_each(|truth| track.take(truth, NOW));
}

#[test]
fn episodes_become_bags_whatever_the_order() {
    let mut track = Track::new(NOW);
    let mut truths = [episode(0, 0, 3), episode(3, 1, 2)].concat();
    truths.reverse();
    take(&mut track, truths.clone());
    take(&mut track, truths);
    assert_eq!(written(&mut track), "o0 0 1 2 f o1 0 1 f");
    assert_eq!((track.next_seq(0), track.has_open_bag()), (5, false));
}

#[test]
fn only_what_is_on_disk_is_acknowledged() {
    let mut track = Track::new(NOW);
    take(&mut track, episode(0, 0, 2));
    take(&mut track, episode(2, 1, 300).into_iter().take(200));
    written(&mut track);
    assert_eq!((track.next_seq(0), track.next_seq(128)), (2, 2 + 128));
}

#[test]
fn an_episode_without_a_last_row_ends_too() {
    let mut track = Track::new(NOW);
    let end = EpisodeEnd { cause: "aborted".into(), ..EpisodeEnd::default() };
    let result = Some(EpisodeResult { end: Some(end), ..EpisodeResult::default() });
    let mut truths = episode(0, 0, 5);
    truths.truncate(3);
    truths.push(StepRecord { seq: 3, step: 2, result, ..StepRecord::default() });
    take(&mut track, truths);
    assert_eq!(written(&mut track), "o0 0 1 2 2 f");
    assert_eq!(track.next_seq(0), 4);
}

#[test]
fn another_episode_cuts_the_one_before() {
    let mut track = Track::new(NOW);
    take(&mut track, episode(0, 0, 9).into_iter().take(3));
    take(&mut track, episode(3, 0, 2));
    assert_eq!(written(&mut track), "o0 0 1 2 c o0 0 1 f");
}

#[test]
fn without_its_first_row_an_episode_has_no_bag() {
    let mut track = Track::new(NOW);
    let mut first = episode(0, 0, 3);
    first[0].header = None;
    take(&mut track, first);
    take(&mut track, episode(3, 1, 1));
    assert_eq!(written(&mut track), "o1 0 f");
}

#[test]
fn lost_rows_cut_the_bag_and_the_next_episode_is_whole() {
    let mut track = Track::new(NOW);
    take(&mut track, episode(0, 0, 9).into_iter().take(3));
    take(&mut track, episode(9, 1, 2));
    assert_eq!(written(&mut track), "o0 0 1 2");
    let mut now = NOW;
    let mut all = String::new();
    while all.is_empty() {
        assert!(track.request(now).is_some() && now < NOW + Duration::from_secs(20));
        track.answered(now);
        now += Duration::from_secs(1);
        all = written(&mut track);
    }
    assert_eq!(all, "c o1 0 1 f");
}

#[test]
fn a_bag_is_taken_up_where_it_was_left() {
    // The server still has rows that are on disk, the first one among them or not.
    for first_kept in [0, 2, 4] {
        let mut track = Track::resume(header(0), 4, NOW);
        assert_eq!(track.next_seq(4), 0, "nothing is known yet");
        assert!(track.request(NOW).is_some());
        take(&mut track, episode(0, 0, 6).into_iter().skip(first_kept));
        track.answered(NOW);
        assert_eq!(written(&mut track), "4 5 f", "from {first_kept}");
        assert_eq!(track.next_seq(0), 6);
    }
}

#[test]
fn a_bag_that_cannot_go_on_is_cut() {
    // A row is missing; the session is at another episode; it is another session of that name.
    let other = EpisodeHeader { seed: 1, ..header(0) };
    let with_other: Vec<StepRecord> = episode(0, 0, 2)
        .into_iter()
        .map(|mut truth| {
            truth.header = truth.header.map(|_| other.clone());
            truth
        })
        .collect();
    let cases = [(episode(0, 0, 7).split_off(5), "c"), (episode(600, 1, 2), "c o1 0 1 f"), (with_other, "c o0 0 1 f")];
    for (truths, expected) in cases {
        let mut track = Track::resume(header(0), 4, NOW);
        while let Some(request) = track.request(NOW) {
            let asked = request.from_seq..request.from_seq + request.count;
            take(&mut track, truths.iter().filter(|truth| asked.contains(&truth.seq)).cloned());
            track.answered(NOW);
        }
        assert_eq!(written(&mut track), expected);
    }
}
