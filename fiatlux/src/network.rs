//! The launcher on a network. A first evaluation needs none of it, so it is a feature of the build.

#[cfg(feature = "network")]
pub use over_zenoh::{RouterArgs, listen, parse_endpoint, router, secure};
#[cfg(not(feature = "network"))]
pub use without::{RouterArgs, listen, parse_endpoint, router, secure};

#[cfg(feature = "network")]
mod over_zenoh {
    use std::path::Path;

    use anyhow::Context as _;
    use clap::Args;
    use fiatlux_carrier::Carrier;
    pub use fiatlux_link::parse_endpoint;
    use fiatlux_link::{CarrierArgs, Link, LinkMode, Role, choose_port};
    use fiatlux_teleop::Secured;

    /// Options of `fiatlux router`.
    #[derive(Debug, Args)]
    pub struct RouterArgs {
        #[command(flatten)]
        link: CarrierArgs,
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

    /// Listens for policies that connect to this server from elsewhere; returns the endpoint with its port.
    pub fn listen(endpoint: &str, server: &str) -> anyhow::Result<(Carrier, String)> {
        let endpoint = free(endpoint)?;
        let link =
            CarrierArgs { listen: vec![endpoint.clone()], serves: Some(server.into()), ..CarrierArgs::default() };
        let link: Link = link.open(Role::Server)?;
        Ok((link.carrier(), endpoint))
    }

    /// TLS for the page, with the certificate of a folder.
    pub fn secure(folder: &Path, hosts: &[String]) -> anyhow::Result<Secured> {
        let (names, secure, said) = fiatlux_tls::secure(folder, hosts)?;
        Ok(Secured { names, secure, said })
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
    use fiatlux_teleop::Secured;

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

    pub fn listen(_: &str, _: &str) -> anyhow::Result<(Carrier, String)> {
        anyhow::bail!(REMEDY)
    }

    pub fn secure(_: &Path, _: &[String]) -> anyhow::Result<Secured> {
        anyhow::bail!(REMEDY)
    }

    pub fn parse_endpoint(text: &str) -> Result<String, String> {
        Ok(text.into())
    }
}
