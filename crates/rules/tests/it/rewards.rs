//! Rewards against closed forms.

mod bound;
mod ends;
mod motion;
mod perfect;
mod potentials;
mod training;

use crate::common::*;
use fiatlux_rules::{Causes, Judge, JudgeOptions, Rewards, Row, Task, Term, Variant, errand};

/// A judge, the reward next to it, and what each term has paid since the start.
struct Meter {
    judge: Judge,
    rewards: Rewards,
    paid: Vec<(&'static str, f64)>,
}

impl Meter {
    /// Of an episode that ends as its task says.
    fn new(task: Task, variant: Variant, start: &Row) -> Self {
        Self::with(task, variant, JudgeOptions::default(), start)
    }

    /// Of an episode that nothing ends.
    fn endless(task: Task, variant: Variant, start: &Row) -> Self {
        let options = JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() };
        Self::with(task, variant, options, start)
    }

    fn with(task: Task, variant: Variant, options: JudgeOptions, start: &Row) -> Self {
        let mut judge = judge_with(task, options);
        let mut rewards = Rewards::new(&judge, variant, joint_groups());
        judge.start(start);
        rewards.start(&judge, start);
        let paid = rewards.terms().iter().map(|term| (term.name, 0.0)).collect();
        Self { judge, rewards, paid }
    }

    fn show(&mut self, row: &Row) {
        self.judge.advance(row);
        for ((_, paid), term) in self.paid.iter_mut().zip(self.rewards.advance(&self.judge, row)) {
            *paid += term.reward;
        }
    }

    /// Payment of a term for the last row.
    fn last(&self, name: &str) -> f64 {
        self.term(name).reward
    }

    fn term(&self, name: &str) -> &Term {
        let term = self.rewards.terms().iter().find(|term| term.name == name);
        term.unwrap_or_else(|| panic!("no term {name} in {:?}", self.paid))
    }

    /// Sum that a term has paid.
    fn paid(&self, name: &str) -> f64 {
        let paid = self.paid.iter().find(|(n, _)| *n == name);
        paid.unwrap_or_else(|| panic!("no term {name} in {:?}", self.paid)).1
    }

    fn total(&self) -> f64 {
        self.paid.iter().map(|(_, paid)| paid).sum()
    }
}

/// Shows states as rows 1 and on of an episode that starts with the first and that nothing ends.
fn play(task: Task, variant: Variant, states: &[&Row]) -> Meter {
    let mut meter = Meter::endless(task, variant, &row_at(0, states[0]));
    for (step, state) in (0..).zip(states).skip(1) {
        meter.show(&row_at(step, state));
    }
    meter
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

/// Puts the ladder's top point into the seat, and the ladder into the air.
fn lift_ladder_to_seat(row: &mut Row) {
    row.things[errand::LADDER] = body(at([FIXTURE[0], FIXTURE[1] - 0.1, FIXTURE[2] - 0.036259 - 1.18]));
}

/// Puts the old bulb's root into the crate's origin. Lying along x, the whole of it is between the walls and below the
/// rim, and partly below the crate.
fn sink_into_crate(row: &mut Row) {
    put_in_crate(row, OLD);
    row.things[errand::BULBS[OLD]].pose =
        row.things[errand::CRATE].pose * rotated([0.0; 3], nalgebra::Vector3::y(), std::f64::consts::FRAC_PI_2);
}

/// A row pays the sum of its terms, and each term its value by its weight over 0.02 s, but for gate progress, which pays
/// its value.
#[test]
fn terms_add_up() {
    let mut draw = Draw(8);
    for (task, variant) in
        Task::ALL.into_iter().flat_map(|task| [(task, Variant::Benchmark), (task, Variant::Training)])
    {
        let mut meter = Meter::endless(task, variant, &start_of(task));
        let (mut total, mut least, mut most) = (0.0, 0.0_f64, 0.0_f64);
        for step in 1..100 {
            let goal = row_at(step, &goal_of(task));
            meter.show(&if draw.one_in(3) { goal } else { draw.row(step) });
            let pays = meter.rewards.reward();
            (total, least, most) = (total + pays, least.min(pays), most.max(pays));
            for term in meter.rewards.terms() {
                let scale = if term.name == "gate_progress" { 1.0 } else { 0.02 * term.weight };
                assert!(close(term.reward, term.value * scale), "{task}: {term:?}");
            }
        }
        assert!((total - meter.total()).abs() < 1e-6 * total.abs().max(1.0), "{task}: {total} {}", meter.total());
        assert!(least < most, "{task} pays nothing that differs");
    }
}

/// The second episode of a judge and a reward pays what the first did.
#[test]
fn nothing_is_carried_into_the_next_episode() {
    let mut draw = Draw(21);
    for task in Task::ALL {
        let rows: Vec<Row> =
            (0..30).map(|step| if step == 20 { row_at(20, &goal_of(task)) } else { draw.row(step) }).collect();
        let mut meter = Meter::endless(task, Variant::Training, &rows[0]);
        rows[1..].iter().for_each(|row| meter.show(row));
        let first = std::mem::take(&mut meter.paid);
        meter.judge.start(&rows[0]);
        meter.rewards.start(&meter.judge, &rows[0]);
        assert!(meter.rewards.terms().iter().all(|term| (term.value, term.reward) == (0.0, 0.0)), "{task}");
        meter.paid = first.iter().map(|(name, _)| (*name, 0.0)).collect();
        rows[1..].iter().for_each(|row| meter.show(row));
        assert_eq!(meter.paid, first, "{task}");
    }
}
