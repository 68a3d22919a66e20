//! The pages, rendered on the server: leaderboard, runs, episodes with their replays, comparisons.
