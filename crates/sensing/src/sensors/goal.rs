//! Place of the lamp as a map would give it: in the frame that the pelvis had at the start. In `climb` the ladder's top.

use fiatlux_rules::Task;
use nalgebra::Point3;

use crate::View;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "goal",
    class: Class::Goal,
    is_large: false,
    needs: Needs::ROW,
    terms: |_| {
        let meaning =
            "the socket's seat from the pelvis as it stood in row 0: ahead, left, up; in climb the ladder's top";
        vec![Term::new("goal", "goal", &[3], "m", meaning)]
    },
    compute: |view, _, out| {
        out.extend(&goal(view));
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.goal = ENTRY.numbers(view, devices)?;
        Ok(())
    },
};

fn goal(view: &View<'_>) -> [f64; 3] {
    let geometry = view.judge.geometry();
    let place = match view.task {
        Task::Climb => geometry.ladder_top(view.row),
        _ => geometry.seat(view.row),
    };
    view.start.inverse_transform_point(&Point3::from(place)).coords.into()
}
