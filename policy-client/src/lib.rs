//! Policies and their session loop.
