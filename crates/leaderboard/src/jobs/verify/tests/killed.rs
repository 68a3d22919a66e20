//! Verifications while the database is killed.

use super::*;

/// Guards verdicts against a database that is killed again and again: scorers go on by themselves, every episode has one verdict, and
/// the log has each submission's end once, without a gap.
#[test]
#[ignore = "needs PostgreSQL: tests/run"]
fn verdicts_outlive_a_server_that_is_killed_on_postgres() {
    let (kills, submissions) = if std::env::var_os("FIATLUX_SLOW_TESTS").is_some() { (20, 100) } else { (4, 20) };
    let mut postgres = crate::stores::Postgres::start("kills");
    let folder = Folder::new("kills");
    let database = crate::stores::database_of(&postgres).parse().unwrap();
    let place = crate::Place { database, ..crate::Place::folder(&folder.0) };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let sleeper = Arc::new(Sleeper { time: Duration::from_millis(60), played: Mutex::default() });
    let store = runtime.block_on(Store::open_at(&place)).unwrap();
    runtime.block_on(fill(&store, submissions, 8));
    let jobs = (0..3).map(|_| {
        runtime.block_on(async {
            let store = Store::open_at(&place).await.unwrap();
            let options = ServiceOptions { lease: Duration::from_secs(2), ..ServiceOptions::default() };
            let service = Arc::new(Service::new(store, options));
            Jobs::verify(&service, vec![Arc::<Sleeper>::clone(&sleeper) as Arc<dyn Verifier>], 2).unwrap()
        })
    });
    let jobs: Vec<Jobs> = jobs.collect();
    for _ in 0..kills {
        std::thread::sleep(Duration::from_millis(700));
        postgres.kill();
    }
    let start = Instant::now();
    let verified = || {
        let states = runtime.block_on(store.states());
        states.is_ok_and(|states| states.iter().all(|count| count.kind == "verified"))
    };
    while !verified() {
        assert!(start.elapsed() < Duration::from_secs(300), "{:?}", runtime.block_on(store.verdicts()));
        std::thread::sleep(Duration::from_millis(50));
    }
    jobs.into_iter().for_each(Jobs::stop);
    let verdicts = runtime.block_on(store.verdicts()).unwrap();
    assert_eq!(
        verdicts.iter().map(|count| (&*count.kind, count.count)).collect::<Vec<_>>(),
        [("equal", submissions as i64 * 8)]
    );
    let log = runtime.block_on(store.list_audit(10_000)).unwrap();
    assert!(log.iter().map(|row| row.seq).eq(1..=log.len() as i64));
    let ends = log.iter().filter(|row| row.action == "submission verified").map(|row| &row.subject);
    assert_eq!(ends.collect::<std::collections::BTreeSet<_>>().len(), submissions as usize);
    assert_eq!(log.len(), submissions as usize);
}
