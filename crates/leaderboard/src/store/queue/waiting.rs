//! A board with nothing but episodes that wait, for tests and measurements.

/// Statements that add an account `lab` and graded submissions 1 to `submissions` of `each` episodes that wait. The last submission was
/// received first.
pub fn statements(submissions: u64, each: u64) -> [String; 4] {
    let numbers =
        |end: u64| format!("WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {end})");
    let received = submissions + 1;
    [
        "INSERT INTO accounts (name, created, submissions_a_day, max_bytes) VALUES ('lab', 0, 1, 1)".to_owned(),
        format!(
            "{} INSERT INTO submissions (id, account, manifest, state, reason, badge, begun, received, bytes) \
             SELECT printf('%016x', i), 'lab', '{{}}', 'graded', '', '', 0, {received} - i, 0 FROM n",
            numbers(submissions)
        ),
        "INSERT INTO files (submission, place, name, bytes, sha256, stored) \
         SELECT id, 0, 'a.mcap', 1, printf('%064x', received), 1 FROM submissions"
            .to_owned(),
        format!(
            "{} INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail, queue) \
             SELECT s.id, 'S01', CAST(n.i AS TEXT), '0', 0, 'waiting', '', '', s.received FROM submissions s, n",
            numbers(each)
        ),
    ]
}
