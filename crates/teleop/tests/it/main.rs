//! Tests over sessions of a server in this process, and over the page's server.

mod attack;
mod common;
mod drive;
mod first_room;
mod grab;
mod page;
mod takes;
mod tls;
