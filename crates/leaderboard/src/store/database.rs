//! The database of a store: SQLite or PostgreSQL, by its URL. Both get the same statements; this file has what differs.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use sqlx::any::{AnyConnectOptions, AnyPoolOptions, AnyRow};
use sqlx::{Any, AnyConnection, AnyPool, ConnectOptions as _, Connection as _, Row as _, Transaction};
use tokio::sync::oneshot;

use super::lock::{self, Held};
use crate::StoreError;

pub(super) type Row = AnyRow;
pub(super) type Tx = Transaction<'static, Any>;

const SQLITE: &str = "leaderboard.sqlite";
/// Time for which a statement waits for another process, such as an admin command.
const BUSY: Duration = Duration::from_secs(20);
const LOOK: Duration = Duration::from_millis(50);
/// Time between two looks whether the lock of the scorers is still held.
const KEEP: Duration = Duration::from_secs(1);
/// Number of connections that read, of one process.
const READERS: u32 = 8;
/// Keys of PostgreSQL's advisory locks, which belong to one database: for writers, for whoever opens it, for its scorers.
const WRITE: i64 = 0x6669_6174_6c75_7801;
const OPEN: i64 = WRITE + 1;
const SCORERS: i64 = WRITE + 2;

/// The address of a database: `sqlite:FILE`, or `postgres://USER@HOST/NAME`.
#[derive(Clone, PartialEq, Eq)]
pub enum DatabaseUrl {
    Sqlite(PathBuf),
    /// As libpq reads it, with `?host=/FOLDER` for a socket.
    Postgres(String),
}

impl DatabaseUrl {
    pub(super) fn in_folder(folder: &Path) -> Self {
        Self::Sqlite(folder.join(SQLITE))
    }

    fn options(&self) -> Result<AnyConnectOptions, StoreError> {
        let url = match self {
            Self::Sqlite(file) => {
                let file = std::path::absolute(file).map_err(StoreError::io("find", file))?;
                let mut url = "sqlite://".to_owned();
                for byte in file.as_os_str().as_encoded_bytes() {
                    match byte {
                        b'/' | b'.' | b'-' | b'_' => url.push(char::from(*byte)),
                        byte if byte.is_ascii_alphanumeric() => url.push(char::from(*byte)),
                        byte => drop(write!(url, "%{byte:02X}")),
                    }
                }
                url + "?mode=rwc"
            }
            Self::Postgres(url) => url.clone(),
        };
        url.parse().map_err(StoreError::database("be found at its address"))
    }
}

impl FromStr for DatabaseUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(file) = text.strip_prefix("sqlite:") {
            let file = file.strip_prefix("//").unwrap_or(file);
            if file.is_empty() || file.contains(['?', '#']) {
                return Err("write the file after sqlite:, such as sqlite:board/leaderboard.sqlite".into());
            }
            return Ok(Self::Sqlite(file.into()));
        }
        if text.starts_with("postgres://") || text.starts_with("postgresql://") {
            let url: Result<AnyConnectOptions, _> = text.parse();
            return url.map(|_| Self::Postgres(text.into())).map_err(|_| "the address cannot be read".into());
        }
        // The text is not repeated: it may have a password.
        Err("a database is sqlite:FILE or postgres://USER@HOST/NAME; others are not known".into())
    }
}

/// Without user and password.
impl std::fmt::Display for DatabaseUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sqlite(file) => write!(f, "{}", file.display()),
            Self::Postgres(url) => {
                let place = url.split_once("://").map_or("", |(_, rest)| rest);
                let place = place.split(['?', '#']).next().unwrap_or_default();
                write!(f, "postgres://{}", place.rsplit('@').next().unwrap_or_default())
            }
        }
    }
}

impl std::fmt::Debug for DatabaseUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DatabaseUrl({self})")
    }
}

#[derive(Debug, Clone)]
pub(super) struct Database {
    pub url: DatabaseUrl,
    options: AnyConnectOptions,
    pub pool: AnyPool,
    /// It has one connection: writers of a process wait for it here, and not in the database with a connection that others could read
    /// with.
    pub writer: AnyPool,
}

impl Database {
    /// Connects to the tables as they are. Creates a database only if it is a file.
    pub async fn connect(url: &DatabaseUrl) -> Result<Self, StoreError> {
        sqlx::any::install_default_drivers();
        let options = url.options()?;
        let is_sqlite = matches!(url, DatabaseUrl::Sqlite(_));
        let pool = |connections| {
            let pool = AnyPoolOptions::new().max_connections(connections).acquire_timeout(BUSY);
            if !is_sqlite {
                return pool;
            }
            pool.after_connect(|connection, _| {
                Box::pin(async move {
                    // When a request is answered, its data must be on disk.
                    for statement in
                        ["PRAGMA busy_timeout = 20000", "PRAGMA journal_mode = WAL", "PRAGMA synchronous = FULL"]
                    {
                        sqlx::raw_sql(statement).execute(&mut *connection).await?;
                    }
                    Ok(())
                })
            })
        };
        let failed = |error| StoreError::database("be opened")(error);
        Ok(Self {
            url: url.clone(),
            writer: pool(1).connect_with(options.clone()).await.map_err(failed)?,
            pool: pool(READERS).connect_lazy_with(options.clone()),
            options,
        })
    }

    /// True if somebody has made tables in it.
    pub async fn exists(url: &DatabaseUrl) -> Result<bool, StoreError> {
        if let DatabaseUrl::Sqlite(file) = url {
            return Ok(file.is_file());
        }
        sqlx::any::install_default_drivers();
        let failed = |error| StoreError::database("be opened")(error);
        let mut connection = url.options()?.connect().await.map_err(failed)?;
        let row = sqlx::query("SELECT to_regclass('schema_version') IS NOT NULL AS is_there");
        row.fetch_one(&mut connection).await.and_then(|row| row.try_get("is_there")).map_err(failed)
    }

    pub fn is_postgres(&self) -> bool {
        matches!(self.url, DatabaseUrl::Postgres(_))
    }

    /// A transaction that writes from its first statement, and with no other such one at the same time: what it reads stays true. SQLite
    /// cannot turn a reader into a writer without races; PostgreSQL would let two read the same state and both change it.
    pub async fn write(&self) -> Result<Tx, StoreError> {
        let begun = if self.is_postgres() {
            let begin =
                format!("BEGIN; SET LOCAL lock_timeout = {}; SELECT pg_advisory_xact_lock({WRITE})", BUSY.as_millis());
            self.writer.begin_with(sqlx::AssertSqlSafe(begin)).await
        } else {
            self.writer.begin_with("BEGIN IMMEDIATE").await
        };
        begun.map_err(StoreError::database("be locked"))
    }

    /// A transaction that sees one state of all tables, whatever is written meanwhile.
    pub async fn snapshot(&self) -> Result<Tx, StoreError> {
        let begin =
            if self.is_postgres() { "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY" } else { "BEGIN DEFERRED" };
        self.pool.begin_with(begin).await.map_err(StoreError::database("be read"))
    }

    /// Text is compared by its bytes, as SQLite does, whatever the language of the database.
    pub fn in_bytes(&self, statement: &str) -> String {
        if self.is_postgres() { statement.replace(" TEXT", " TEXT COLLATE \"C\"") } else { statement.to_owned() }
    }

    /// The end of a SELECT that picks rows to claim: PostgreSQL passes by those that another one is claiming.
    pub fn passing_by(&self, statement: &str) -> String {
        statement.replace("/* FOR UPDATE */", if self.is_postgres() { "FOR UPDATE OF e SKIP LOCKED" } else { "" })
    }

    /// The place of all scorers of the store, or of one that is alone; `None` if others keep it for so long.
    pub async fn held(&self, alone: bool, patience: Duration) -> Result<Option<Held>, StoreError> {
        if let DatabaseUrl::Sqlite(file) = &self.url {
            let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            return lock::held(folder, alone, patience).await;
        }
        let Some(connection) = self.locked(alone, patience).await? else { return Ok(None) };
        if alone {
            return Ok(Some(Held::Connection { _connection: connection }));
        }
        let (until_dropped, dropped) = oneshot::channel();
        tokio::spawn(keep(self.clone(), connection, dropped));
        Ok(Some(Held::Shared { _until_dropped: until_dropped }))
    }

    /// A connection that holds the lock of the scorers.
    async fn locked(&self, alone: bool, patience: Duration) -> Result<Option<AnyConnection>, StoreError> {
        let failed = |error| StoreError::database("be locked")(error);
        let mut connection = self.connection().await?;
        let ask = if alone {
            "SELECT pg_try_advisory_lock($1) AS is_held"
        } else {
            "SELECT pg_try_advisory_lock_shared($1) AS is_held"
        };
        let start = Instant::now();
        loop {
            let row = sqlx::query(ask).bind(SCORERS).fetch_one(&mut connection).await.map_err(failed)?;
            if row.try_get::<bool, _>("is_held").map_err(failed)? {
                return Ok(Some(connection));
            }
            if start.elapsed() >= patience {
                return Ok(None);
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// A turn among those that open the database: two must not make the same tables at once.
    pub async fn opening(&self) -> Result<Option<AnyConnection>, StoreError> {
        if !self.is_postgres() {
            return Ok(None);
        }
        let mut connection = self.connection().await?;
        let lock = sqlx::query("SELECT pg_advisory_lock($1)").bind(OPEN).execute(&mut connection).await;
        lock.map(|_| Some(connection)).map_err(StoreError::database("be locked"))
    }

    async fn connection(&self) -> Result<AnyConnection, StoreError> {
        self.options.connect().await.map_err(StoreError::database("be opened"))
    }

    pub async fn close(&self) {
        self.pool.close().await;
        self.writer.close().await;
    }
}

/// Keeps the lock that scorers share until `dropped`: takes it again where the connection broke, such as after a restart of PostgreSQL.
async fn keep(database: Database, mut connection: AnyConnection, mut dropped: oneshot::Receiver<()>) {
    let mut is_lost = false;
    while tokio::time::timeout(KEEP, &mut dropped).await.is_err() {
        is_lost = is_lost || connection.ping().await.is_err();
        if is_lost && let Ok(Some(again)) = database.locked(false, Duration::ZERO).await {
            (connection, is_lost) = (again, false);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Guards that a wrong address is refused before anything is made, and that no message has a password.
    #[test]
    fn addresses_of_databases() {
        let read = |text: &str| text.parse::<DatabaseUrl>();
        assert_eq!(read("sqlite:board/a.sqlite").unwrap(), DatabaseUrl::Sqlite("board/a.sqlite".into()));
        assert_eq!(read("sqlite:///srv/a.sqlite").unwrap(), DatabaseUrl::Sqlite("/srv/a.sqlite".into()));
        let postgres = read("postgres://board:secret@db.lan:5433/board?sslmode=verify-full").unwrap();
        assert_eq!(
            format!("{postgres} {postgres:?}"),
            "postgres://db.lan:5433/board DatabaseUrl(postgres://db.lan:5433/board)"
        );
        for text in [
            "",
            "board",
            "sqlite:",
            "sqlite:a?mode=ro",
            "mysql://u:secret@h/d",
            "postgres:/secret",
            "postgres://:secret@:x",
        ] {
            let refused = read(text).unwrap_err();
            assert!(!refused.contains("secret"), "{text}: {refused}");
        }
    }

    /// Guards folders whose names mean something in a URL.
    #[tokio::test]
    async fn a_folder_may_have_any_name() {
        let root = std::env::temp_dir().join(format!("fiatlux-names-{}", std::process::id()));
        let folder = root.join("a b?c#d%41&é");
        std::fs::create_dir_all(&folder).unwrap();
        drop(Database::connect(&DatabaseUrl::in_folder(&folder)).await.unwrap());
        assert!(folder.join(SQLITE).is_file());
        std::fs::remove_dir_all(&root).unwrap();
    }
}
