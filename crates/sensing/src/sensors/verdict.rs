//! Criteria of the gate, its progress, and the reward of the step.

use fiatlux_proto::v3;

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "verdict",
    class: Class::Privileged,
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, _, out| {
        let verdict = view.judge.verdict();
        verdict.criteria.as_slice().iter().for_each(|holds| out.put(f64::from(u8::from(*holds))));
        out.put(verdict.progress);
        out.put(view.reward);
        Ok(())
    },
    encode: |view, _, observation| {
        let verdict = view.judge.verdict();
        observation.verdict = Some(v3::Verdict {
            criteria: verdict.criteria.as_slice().to_vec(),
            gate_progress: verdict.progress,
            reward: view.reward,
        });
        Ok(())
    },
};

fn terms(setup: &Setup) -> Vec<Term> {
    let criteria = setup.task.spec().gate.n(setup.protocol) as usize;
    vec![
        Term::new("criteria", "verdict.criteria", &[criteria], "", "whether each criterion of the gate holds")
            .within(0.0, 1.0),
        Term::new("gate_progress", "verdict.gate_progress", &[], "", "progress towards the gate so far")
            .within(0.0, 1.0),
        Term::new("reward", "verdict.reward", &[], "", "what this step paid"),
    ]
}
