//! A whole episode over a channel that loses and delays messages.

use super::fake::{Dice, FakeServer, info};
use super::*;

/// A message under way: to the server an output of the client, to the client an input.
enum Mail {
    ToServer(Output),
    ToClient(Input),
}

/// Sends messages: one in ten is lost, each takes 1 to 40 ms, and may overtake others.
struct Channel {
    dice: Dice,
    messages: Vec<(Duration, Mail)>,
    lost: usize,
}

impl Channel {
    fn send(&mut self, now: Duration, message: Mail) {
        let arrival = now + Duration::from_millis(1 + self.dice.below(40));
        if self.dice.below(10) > 0 {
            return self.messages.push((arrival, message));
        }
        self.lost += 1;
        // Zenoh reports when a query has timed out.
        let (secs, ended) = match message {
            Mail::ToServer(Output::Reset(_)) | Mail::ToClient(Input::Reset(_)) => (5, Input::Reset(None)),
            Mail::ToServer(Output::AskObservation) | Mail::ToClient(Input::LastObservation(_)) => {
                (2, Input::LastObservation(None))
            }
            _ => return,
        };
        self.messages.push((now + Duration::from_secs(secs), Mail::ToClient(ended)));
    }

    fn next(&mut self) -> Option<(Duration, Mail)> {
        let first = (0..self.messages.len()).min_by_key(|&message| self.messages[message].0)?;
        Some(self.messages.swap_remove(first))
    }
}

/// The server's reply to a message, if any.
fn serve(server: &mut FakeServer, output: &Output) -> Option<Input> {
    match output {
        Output::Reset(bytes) => Some(Input::Reset(Some(Ok(server.reset(bytes).into())))),
        Output::Action(bytes) => server.act(bytes).map(|bytes| Input::Observation(bytes.into())),
        Output::AskObservation => Some(Input::LastObservation(Some(Ok(server.present().encode_to_vec().into())))),
        _ => None,
    }
}

/// Plays an episode whose first `foreseen` actions are known in advance. Returns the steps that the policy was shown, the
/// steps that the server took, and the number of lost messages.
fn play(seed: u64, horizon: u64, foreseen: u64) -> (Vec<u64>, Vec<u64>, usize) {
    let mut channel = Channel { dice: Dice::new(seed), messages: Vec::new(), lost: 0 };
    let mut server = FakeServer::new(horizon);
    let mut session = ClientSession::new(&info(2, false));
    let (mut shown, mut now) = (Vec::new(), Duration::ZERO);
    session.handle(Input::Start(7), now);
    loop {
        while let Some(output) = session.poll() {
            match output {
                Output::Observation(observation) => {
                    shown.push(observation.step);
                    session.handle(Input::Command(Command::Action(vec![0.0; 2])), now);
                }
                Output::Done(end) => {
                    assert_eq!(end.steps, horizon);
                    return (shown, server.taken, channel.lost);
                }
                Output::Failed(failure) => panic!("seed {seed}: {failure}"),
                Output::RoundTrip(_) => {}
                sent => channel.send(now, Mail::ToServer(sent)),
            }
        }
        if session.next_step().is_some_and(|step| step < foreseen) {
            session.handle(Input::Command(Command::Action(vec![0.0; 2])), now);
            continue;
        }
        let wake = session.wake_at().expect("something to wait for");
        match channel.next() {
            Some((arrival, message)) if arrival <= wake => {
                now = arrival;
                match message {
                    Mail::ToServer(output) => {
                        if let Some(input) = serve(&mut server, &output) {
                            channel.send(now, Mail::ToClient(input));
                        }
                    }
                    Mail::ToClient(input) => session.handle(input, now),
                }
            }
            later => {
                channel.messages.extend(later);
                now = wake;
                session.handle(Input::Tick, now);
            }
        }
    }
}

/// Guards that lost messages only cost time: the policy sees each observation once, in order, and the server takes each step
/// once.
#[test]
fn an_episode_over_a_lossy_channel_is_the_same_episode() {
    for seed in 0..20 {
        let (shown, taken, lost) = play(seed, 500, 0);
        let all: Vec<u64> = (0..500).collect();
        assert_eq!(shown, all, "seed {seed}");
        assert_eq!(taken, all, "seed {seed}");
        assert!(lost > 50, "seed {seed} lost {lost}");
    }
}

#[test]
fn actions_ahead_over_a_lossy_channel_are_taken_in_order() {
    for seed in 0..20 {
        let (shown, taken, lost) = play(seed, 500, 400);
        assert_eq!(taken, (0..500).collect::<Vec<u64>>(), "seed {seed}");
        assert_eq!(shown[0], 0);
        assert_eq!(shown[shown.len() - 100..], (400..500).collect::<Vec<u64>>(), "seed {seed}");
        assert!(lost > 30, "seed {seed} lost {lost}");
    }
}
