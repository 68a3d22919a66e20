//! Shapes that are kept apart.

use fiatlux_dynamics::{BodyId, Model, ShapeId};

use super::shape::{BULB_NAME, SOCKET_NAME};

/// Shapes from which the arm is kept apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Apart {
    /// All that surrounds it.
    All,
    /// The same, while the hand holds the bulb.
    Carrying,
    /// The same, while the socket may hold the bulb, too.
    Working,
}

/// True where a body hangs on another one, or is it.
pub(super) fn is_below(model: &Model, mut body: BodyId, above: BodyId) -> bool {
    while body != above && body != BodyId::WORLD {
        body = model.bodies()[body.0].spec.parent;
    }
    body == above
}

/// Pairs of shapes of which one moves with the arm between two bodies, the last of which carries the hand, in the order of
/// [`Apart`]; then those of the world and of neither this arm nor the legs from the thighs down.
pub(super) fn pairs(
    model: &Model,
    thighs: [BodyId; 2],
    shoulder: BodyId,
    hand: BodyId,
) -> [Vec<(ShapeId, ShapeId)>; 4] {
    let is_below = |body: BodyId, above: BodyId| is_below(model, body, above);
    let body = |shape: ShapeId| model.shapes()[shape.0].body;
    let is_bulb = |shape: ShapeId| model.shapes()[shape.0].name.starts_with(BULB_NAME);
    let moves = |shape: ShapeId| is_below(body(shape), shoulder);
    let is_hand = |shape: ShapeId| is_below(body(shape), hand);
    let own = |&(a, b): &(ShapeId, ShapeId)| {
        let is_own = moves(a) && moves(b) && (is_hand(a) == is_hand(b));
        (moves(a) || moves(b)) && !is_own
    };
    let all: Vec<_> = model.shape_pairs().filter(own).collect();
    let is_socket = |shape: ShapeId| model.shapes()[shape.0].name.starts_with(SOCKET_NAME);
    let meets = |(a, b): (ShapeId, ShapeId), is_other: &dyn Fn(ShapeId) -> bool| {
        is_bulb(a) && is_other(b) || is_bulb(b) && is_other(a)
    };
    let carrying: Vec<_> = all.iter().copied().filter(|pair| !meets(*pair, &is_hand)).collect();
    let working = carrying.iter().copied().filter(|pair| !meets(*pair, &is_socket)).collect();
    let is_body = |shape: ShapeId| {
        body(shape) != BodyId::WORLD && !moves(shape) && thighs.iter().all(|thigh| !is_below(body(shape), *thigh))
    };
    let of_body =
        |&(a, b): &(ShapeId, ShapeId)| body(a) == BodyId::WORLD && is_body(b) || body(b) == BodyId::WORLD && is_body(a);
    [all, carrying, working, model.shape_pairs().filter(of_body).collect()]
}
