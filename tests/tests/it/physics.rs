//! The world against closed forms, MuJoCo and its own laws.

mod drops;
mod hand;
mod holding;
mod hostile;
mod on_ladder;
mod oracle;
mod props;
mod socket;
mod standing;
mod starts;
