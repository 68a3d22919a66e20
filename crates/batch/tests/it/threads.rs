//! No thread waits while there are worlds to step.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use fiatlux_batch::{Bank, Control, Outcome, Outputs, Spec, Task, TaskError};
use fiatlux_rules::Row;
use fiatlux_world::{Light, Random, Scene, World};

use crate::common::{floor, simple};

/// A task whose step with action 1 waits until this many others were taken, at most ten seconds.
#[derive(Clone)]
struct Patient {
    spec: Spec,
    others: usize,
    taken: Arc<AtomicUsize>,
}

impl Task for Patient {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&mut self, _: &World, _: &Light, _: &mut Random) -> Result<(), TaskError> {
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _: &Row, action: &[f64], _: &mut Random, control: &mut Control) {
        control.joint_target.copy_from_slice(scene.robot.q0());
        let mut waits = 0;
        while action[0] == 1.0 && self.taken.load(Ordering::SeqCst) < self.others {
            assert!(waits < 10_000, "nobody takes the other worlds");
            waits += 1;
            std::thread::sleep(Duration::from_millis(1));
        }
        self.taken.fetch_add(1, Ordering::SeqCst);
    }

    fn judge(&mut self, _: &World, _: &mut Random, _: &mut [f32]) -> Outcome {
        Outcome::Continues
    }

    fn observe(&mut self, _: &World, _: &mut [f32]) -> Result<(), TaskError> {
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "patient".into())]
    }
}

/// Whichever thread has the slow world, the other one takes all the rest.
#[test]
fn a_slow_world_holds_up_no_other() {
    let spec = Spec {
        actions: vec!["wait".into()],
        action_range: vec![[0.0, 1.0]],
        horizon_steps: 100,
        action_limit: 1.0,
        observation: vec![],
        rewards: vec![],
        reward_weights: vec![],
    };
    let taken = Arc::new(AtomicUsize::new(0));
    let task = Patient { spec, others: 5, taken: Arc::clone(&taken) };
    let mut batch = simple(Bank::standing(floor()), &task, 6, 2);
    let mut outputs = Outputs::new(&batch);
    for slow in [0, 5] {
        taken.store(0, Ordering::SeqCst);
        let mut actions = [0.0; 6];
        actions[slow] = 1.0;
        batch.step(&actions, &mut outputs.buffers()).unwrap();
        assert_eq!(taken.load(Ordering::SeqCst), 6);
    }
}
