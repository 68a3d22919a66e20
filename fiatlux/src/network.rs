//! The launcher on a network. A first evaluation needs none of it, so it is a feature of the build.

#[cfg(feature = "network")]
pub use over_zenoh::{RouterArgs, listen, over_tls, parse_endpoint, router};
#[cfg(not(feature = "network"))]
pub use without::{RouterArgs, listen, over_tls, parse_endpoint, router};

#[cfg(feature = "network")]
mod over_zenoh {
    use std::path::Path;

    use anyhow::Context as _;
    use clap::Args;
    use fiatlux_carrier::Carrier;
    pub use fiatlux_link::parse_endpoint;
    use fiatlux_link::{Link, LinkArgs, LinkMode, Role, choose_port};
    use fiatlux_teleop::Cockpit;
    use fiatlux_tls::{Certificate, Tls, own_hosts};

    /// Options of `fiatlux router`.
    #[derive(Debug, Args)]
    pub struct RouterArgs {
        #[command(flatten)]
        link: LinkArgs,
    }

    /// Runs the command `fiatlux router`.
    pub fn router(args: RouterArgs) -> anyhow::Result<()> {
        fiatlux_cli::init_log();
        let stop = fiatlux_cli::stop_on_signal()?;
        let mut link = args.link;
        link.mode = Some(link.mode.unwrap_or(LinkMode::Router));
        for endpoint in &mut link.listen {
            *endpoint = free(endpoint)?;
        }
        let session = link.open_unless(Role::Server, &stop)?;
        fiatlux_cli::print(format!("{} as a router\n", link.place(Role::Server)?))?;
        fiatlux_cli::wait_for(&stop);
        Ok(session.close()?)
    }

    /// Listens for policies that connect from elsewhere; returns the endpoint with its port.
    pub fn listen(endpoint: &str) -> anyhow::Result<(Carrier, String)> {
        let endpoint = free(endpoint)?;
        let link: Link = LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() }.open(Role::Server)?;
        Ok((link.carrier(), endpoint))
    }

    /// Serves the page over TLS, with the certificate of a folder; returns what its user has to know.
    pub fn over_tls(cockpit: Cockpit, folder: &Path, hosts: &[String]) -> anyhow::Result<(Cockpit, String)> {
        let own = own_hosts();
        // Of its own names, only the one in the page's address must be in the certificate.
        let hosts = if hosts.is_empty() { &own[..1] } else { hosts };
        let certificate = Certificate::open(folder, hosts, &own)?;
        let tls = Tls::new(&certificate);
        let secured = cockpit.over_tls(&hosts[0], Box::new(move |stream| Box::pin(tls.clone().accept(stream))));
        let age = if certificate.is_new() { "made now" } else { "as before" };
        let said = format!(
            "The certificate in {}, {age}, has the SHA-256 fingerprint\n  {}\n\
             The headset's browser warns once that it does not know this certificate: choose Advanced, compare the fingerprint where \
             it shows one, and proceed.\n\
             It asks again when the certificate has expired after a year, or was made anew.",
            folder.display(),
            certificate.fingerprint()
        );
        Ok((secured, said))
    }

    fn free(endpoint: &str) -> anyhow::Result<String> {
        choose_port(endpoint)
            .with_context(|| format!("no free port for {endpoint}; is its host one of this machine's addresses?"))
    }
}

#[cfg(not(feature = "network"))]
mod without {
    use std::path::Path;

    use clap::Args;
    use fiatlux_carrier::Carrier;
    use fiatlux_teleop::Cockpit;

    const REMEDY: &str = "this build of fiatlux has no network, so that it is compiled sooner; build the rest with \
                          `cargo build --release -p fiatlux --features network`";

    /// Options of `fiatlux router`.
    #[derive(Debug, Args)]
    pub struct RouterArgs {
        /// Options of a build with the network
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<String>,
    }

    pub fn router(args: RouterArgs) -> anyhow::Result<()> {
        tracing::debug!(options = ?args.options, "not read");
        anyhow::bail!(REMEDY)
    }

    pub fn listen(_: &str) -> anyhow::Result<(Carrier, String)> {
        anyhow::bail!(REMEDY)
    }

    pub fn over_tls(_: Cockpit, _: &Path, _: &[String]) -> anyhow::Result<(Cockpit, String)> {
        anyhow::bail!(REMEDY)
    }

    pub fn parse_endpoint(text: &str) -> Result<String, String> {
        Ok(text.into())
    }
}
