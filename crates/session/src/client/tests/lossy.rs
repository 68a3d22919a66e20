//! A whole episode over a channel that loses and delays messages.

use super::fake::{Dice, FakeServer, info};
use super::*;

/// A message under way.
enum Post {
    Reset(Vec<u8>),
    Action(Vec<u8>),
    Ask,
    ResetReply(Option<Vec<u8>>),
    Observation(Vec<u8>),
    LastObservation(Option<Vec<u8>>),
}

/// Sends messages on their way: one of ten is lost, each takes 1 to 40 ms, and may overtake others.
struct Channel {
    dice: Dice,
    posts: Vec<(f64, Post)>,
    lost: usize,
}

impl Channel {
    fn send(&mut self, now_s: f64, post: Post) {
        let arrival_s = now_s + 0.001 * (1 + self.dice.below(40)) as f64;
        if self.dice.below(10) > 0 {
            return self.posts.push((arrival_s, post));
        }
        self.lost += 1;
        // Zenoh tells when a query has run into its time-out.
        match post {
            Post::Reset(_) | Post::ResetReply(_) => self.posts.push((now_s + 5.0, Post::ResetReply(None))),
            Post::Ask | Post::LastObservation(_) => self.posts.push((now_s + 2.0, Post::LastObservation(None))),
            Post::Action(_) | Post::Observation(_) => {}
        }
    }

    fn next(&mut self) -> Option<(f64, Post)> {
        let first = (0..self.posts.len()).min_by(|&a, &b| self.posts[a].0.total_cmp(&self.posts[b].0))?;
        Some(self.posts.swap_remove(first))
    }
}

/// Plays an episode; what the policy was shown, the steps that the server took, and how many messages were lost.
fn play(seed: u64, horizon: u64) -> (Vec<u64>, Vec<u64>, usize) {
    let mut channel = Channel { dice: Dice::new(seed), posts: Vec::new(), lost: 0 };
    let mut server = FakeServer::new(horizon);
    let mut session = ClientSession::new(&info(2, false));
    let (mut shown, mut now_s) = (Vec::new(), 0.0);
    session.start(7, now_s);
    loop {
        while let Some(output) = session.poll() {
            match output {
                Output::Reset(bytes) => channel.send(now_s, Post::Reset(bytes)),
                Output::Action(bytes) => channel.send(now_s, Post::Action(bytes)),
                Output::AskObservation => channel.send(now_s, Post::Ask),
                Output::Done(end) => {
                    assert_eq!(end.steps, horizon);
                    return (shown, server.taken, channel.lost);
                }
                Output::Failed(failure) => panic!("seed {seed}: {failure}"),
            }
        }
        if let Some(observation) = session.to_answer() {
            shown.push(observation.step);
            session.act("test", Command::Action(vec![0.0; 2]), now_s).expect("a good command");
            continue;
        }
        let wake_s = session.wake_s().expect("something to wait for");
        match channel.next() {
            Some((arrival_s, post)) if arrival_s <= wake_s => {
                now_s = arrival_s;
                match post {
                    Post::Reset(bytes) => channel.send(now_s, Post::ResetReply(Some(server.reset(&bytes)))),
                    Post::Action(bytes) => {
                        if let Some(bytes) = server.act(&bytes) {
                            channel.send(now_s, Post::Observation(bytes));
                        }
                    }
                    Post::Ask => {
                        channel.send(now_s, Post::LastObservation(Some(server.present().encode_to_vec())));
                    }
                    Post::ResetReply(Some(bytes)) => session.reset_reply(&bytes, now_s),
                    Post::ResetReply(None) => session.reset_unanswered(now_s),
                    Post::Observation(bytes) => session.observation(&bytes, now_s),
                    Post::LastObservation(Some(bytes)) => {
                        session.observation_answered();
                        session.observation(&bytes, now_s);
                    }
                    Post::LastObservation(None) => session.observation_refused(None),
                }
            }
            later => {
                channel.posts.extend(later);
                now_s = wake_s;
                session.tick(now_s);
            }
        }
    }
}

/// Lost messages cost time: the policy still sees each observation once, in order, and the server takes each step once.
#[test]
fn an_episode_over_a_lossy_channel_is_the_same_episode() {
    for seed in 0..20 {
        let (shown, taken, lost) = play(seed, 500);
        let all: Vec<u64> = (0..500).collect();
        assert_eq!(shown, all, "seed {seed}");
        assert_eq!(taken, all, "seed {seed}");
        assert!(lost > 50, "seed {seed} lost {lost}");
    }
}
