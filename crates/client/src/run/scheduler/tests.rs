use super::*;

fn scheduler(episodes: usize, servers: &[(&str, usize)]) -> Scheduler {
    let mut scheduler = Scheduler::new(episodes, 100);
    servers.iter().for_each(|(name, room)| scheduler.server_joins(name, *room));
    scheduler
}

/// Hands out as many episodes as possible, and opens each session at once.
fn hand_out(scheduler: &mut Scheduler) -> Vec<(usize, String)> {
    let next = || {
        let next = scheduler.next()?;
        scheduler.opened(next.0);
        Some(next)
    };
    std::iter::from_fn(next).collect()
}

fn on(given: &[(usize, String)]) -> Vec<(usize, &str)> {
    given.iter().map(|(index, server)| (*index, server.as_str())).collect()
}

/// A ledger with one letter for each episode: `.` not begun, `o` open, `p` played, `f` failed.
fn ledger(states: &str) -> Vec<RunEpisode> {
    let state = |letter| match letter {
        'o' => Ledger::Open,
        'p' => Ledger::Played,
        'f' => Ledger::Failed,
        _ => Ledger::Unspecified,
    };
    states.chars().map(|letter| RunEpisode { state: state(letter).into(), ..RunEpisode::default() }).collect()
}

fn tell(scheduler: &mut Scheduler, server: &str, states: &str) -> Vec<usize> {
    scheduler.merge_ledger(server, scheduler.moment() + 1, &ledger(states))
}

#[test]
fn episodes_go_to_the_least_loaded_server_as_far_as_there_is_room() {
    let mut run = scheduler(6, &[("a", 1), ("b", 3)]);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a"), (1, "b"), (2, "b"), (3, "b")]);
    run.ended(0);
    assert_eq!(on(&hand_out(&mut run)), [(4, "a")], "the end of an episode makes room before it is confirmed");
    assert_eq!((run.to_ask(), run.is_over()), (vec!["a".to_string()], false));
}

#[test]
fn no_more_at_once_than_asked_for() {
    let mut run = Scheduler::new(5, 2);
    run.server_joins("a", 9);
    assert_eq!(hand_out(&mut run).len(), 2);
    run.ended(1);
    assert_eq!(on(&hand_out(&mut run)), [(2, "a")]);
}

#[test]
fn an_episode_is_done_when_a_ledger_says_so() {
    let mut run = scheduler(2, &[("a", 2)]);
    hand_out(&mut run);
    (0..2).for_each(|index| run.ended(index));
    assert!(tell(&mut run, "a", "po").is_empty() && !run.is_over());
    assert!(tell(&mut run, "a", "pf").is_empty() && run.is_over());
    assert_eq!(hand_out(&mut run), []);
}

/// The state of a resumed run comes from the servers.
#[test]
fn a_run_goes_on_where_the_ledgers_are() {
    let mut run = scheduler(5, &[("a", 9), ("b", 9)]);
    tell(&mut run, "a", "p..o.");
    tell(&mut run, "b", ".f...");
    assert_eq!(on(&hand_out(&mut run)), [(2, "a"), (4, "b")]);
    // The session of the previous client ends.
    tell(&mut run, "a", "p.o..");
    assert_eq!(on(&hand_out(&mut run)), [(3, "a")], "where it was begun");
}

#[test]
fn what_a_lost_server_played_goes_to_the_others() {
    let mut run = scheduler(4, &[("a", 2), ("b", 2)]);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a"), (1, "b"), (2, "a"), (3, "b")]);
    run.ended(0);
    run.server_leaves("a");
    assert_eq!(run.strays(), [2]);
    run.set_back(2, AttemptFailure::BrokenOff);
    (1..4).step_by(2).for_each(|index| run.ended(index));
    assert_eq!(on(&hand_out(&mut run)), [(0, "b"), (2, "b")], "also what was not yet on disk");
}

#[test]
fn with_no_other_server_an_episode_waits_for_the_lost_one() {
    let mut run = scheduler(2, &[("a", 1)]);
    hand_out(&mut run);
    run.server_leaves("a");
    assert!(run.strays().is_empty() && !run.has_server());
    // It reappears, and still has the session.
    run.server_joins("a", 1);
    assert!(tell(&mut run, "a", "o.").is_empty());
    // It reappears without the session.
    assert_eq!(tell(&mut run, "a", ".."), [0]);
    run.set_back(0, AttemptFailure::BrokenOff);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
}

#[test]
fn an_answer_older_than_the_session_breaks_nothing_off() {
    let mut run = scheduler(2, &[("a", 2)]);
    let asked = run.moment();
    hand_out(&mut run);
    assert!(run.merge_ledger("a", asked, &ledger("..")).is_empty());
    run.ended(0);
    assert!(run.merge_ledger("a", asked, &ledger("..")).is_empty());
    assert!(matches!(run.standings().next(), Some((Standing::Ended { .. }, None))));
}

/// A ledger that does not list a session yet, because it is still being opened, does not count against it.
#[test]
fn a_session_on_its_way_is_not_broken_off() {
    let mut run = scheduler(1, &[("a", 1)]);
    run.next().expect("hands out");
    assert!(tell(&mut run, "a", ".").is_empty());
}

#[test]
fn an_episode_that_another_server_has_played_is_broken_off() {
    let mut run = scheduler(2, &[("a", 2), ("b", 2)]);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a"), (1, "b")]);
    assert_eq!(tell(&mut run, "b", "p."), [0, 1], "and so is one that its server no longer plays");
    run.set_back(0, AttemptFailure::BrokenOff);
    assert!(matches!(run.standings().next(), Some((Standing::Decided { server, .. }, _)) if server == "b"));
}

#[test]
fn an_episode_that_goes_wrong_comes_last_and_is_given_up_in_the_end() {
    let mut run = Scheduler::new(2, 1);
    run.server_joins("a", 1);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
    run.set_back(0, AttemptFailure::Failed("silence".into()));
    assert_eq!(on(&hand_out(&mut run)), [(1, "a")]);
    run.ended(1);
    tell(&mut run, "a", ".p");
    for _ in 1..MAX_TRIES {
        assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
        run.set_back(0, AttemptFailure::Failed("silence".into()));
    }
    assert!(hand_out(&mut run).is_empty() && run.is_over());
    assert_eq!(run.standings().next(), Some((&Standing::Lost, Some("silence"))));
}

#[test]
fn a_policy_that_cannot_go_on_is_not_asked_again() {
    let mut run = scheduler(1, &[("a", 1)]);
    hand_out(&mut run);
    run.set_back(0, AttemptFailure::Hopeless("NaN".into()));
    assert!(hand_out(&mut run).is_empty() && run.is_over());
}

#[test]
fn a_busy_server_gets_no_more_than_it_takes() {
    let mut run = scheduler(3, &[("a", 8)]);
    assert_eq!(hand_out(&mut run).len(), 3);
    run.set_back(2, AttemptFailure::Busy);
    assert!(hand_out(&mut run).is_empty());
    run.ended(0);
    assert_eq!(on(&hand_out(&mut run)), [(2, "a")]);
    // Others use all its room: it is asked again later, not at once.
    let mut alone = scheduler(1, &[("a", 8)]);
    hand_out(&mut alone);
    alone.set_back(0, AttemptFailure::Busy);
    assert!(hand_out(&mut alone).is_empty());
    assert_eq!(alone.to_ask(), ["a"]);
    tell(&mut alone, "a", ".");
    assert_eq!(on(&hand_out(&mut alone)), [(0, "a")]);
}

#[test]
fn what_could_not_be_recorded_is_played_again() {
    let mut run = scheduler(1, &[("a", 1)]);
    hand_out(&mut run);
    run.ended(0);
    tell(&mut run, "a", ".");
    assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
}

#[test]
fn a_refused_episode_waits_for_the_ledgers_word() {
    let mut run = scheduler(1, &[("a", 1)]);
    run.next().expect("hands out");
    run.set_back(0, AttemptFailure::Refused("it is open".into()));
    assert!(run.next().is_none());
    tell(&mut run, "a", "o");
    assert!(run.next().is_none());
    tell(&mut run, "a", "p");
    assert!(run.is_over());
}

/// The session of a client that died stays open for a while; that does not count as a failure of the episode.
#[test]
fn an_episode_that_is_open_elsewhere_is_waited_for() {
    let mut run = scheduler(1, &[("a", 1)]);
    for _ in 0..=MAX_TRIES {
        assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
        run.set_back(0, AttemptFailure::Held);
        assert_eq!((run.next(), run.to_ask()), (None, vec!["a".into()]));
        tell(&mut run, "a", "o");
        assert_eq!(run.next(), None);
        tell(&mut run, "a", ".");
    }
}

/// A server that joins late gets its share.
#[test]
fn a_server_that_appears_later_joins() {
    let mut run = scheduler(3, &[("a", 1)]);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
    run.server_joins("b", 2);
    assert_eq!(on(&hand_out(&mut run)), [(1, "b"), (2, "b")]);
}

/// A server that is missing for a moment keeps its episodes; failures there meanwhile do not count.
#[test]
fn a_missing_server_gets_nothing_new() {
    let mut run = scheduler(4, &[("a", 2), ("b", 1)]);
    assert_eq!(on(&hand_out(&mut run)), [(0, "a"), (1, "b"), (2, "a")]);
    run.server_is_missed("a");
    assert_eq!((run.strays(), run.next()), (vec![], None));
    for _ in 0..=MAX_TRIES {
        run.set_back(2, AttemptFailure::Failed("silence".into()));
        run.server_joins("a", 2);
        assert_eq!(on(&hand_out(&mut run)), [(2, "a")]);
        run.server_is_missed("a");
    }
}

/// Guards hosted runs of servers with folders of their own: each episode waits for its one server, others are not held up by it, and what
/// another server says of it counts for nothing.
#[test]
fn an_episode_waits_for_its_own_server() {
    let owned = |of: &str| {
        let mut ledger = ledger("....");
        for (index, entry) in ledger.iter_mut().enumerate() {
            let owner = ["a", "b"][index % 2];
            if owner != of {
                entry.server = owner.into();
            }
        }
        ledger
    };
    let mut run = scheduler(4, &[("a", 1)]);
    run.merge_ledger("a", run.moment() + 1, &owned("a"));
    assert_eq!(on(&hand_out(&mut run)), [(0, "a")]);
    run.ended(0);
    assert_eq!(on(&hand_out(&mut run)), [(2, "a")], "episode 1 is not lost, and holds up nobody");
    run.server_joins("b", 4);
    run.merge_ledger("b", run.moment() + 1, &owned("b"));
    assert_eq!(on(&hand_out(&mut run)), [(1, "b"), (3, "b")]);
    // The run is closed on a: its ledger has failed what was not begun there.
    assert!(tell(&mut run, "a", "pfpf").is_empty());
    assert!(!run.is_over());
    assert!(tell(&mut run, "b", "fpfp").is_empty());
    assert!(run.is_over());
    assert!(
        run.standings().all(
            |(standing, _)| matches!(standing, Standing::Decided { entry, .. } if entry.state() == Ledger::Played)
        )
    );
}
