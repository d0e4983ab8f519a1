//! The pages' listener: connections under the same watch as those of calls. None lives longer than a first call may
//! take to come.

use std::{io, net::SocketAddr};

use axum::serve::Listener;
use futures::StreamExt as _;
use tokio::net::{TcpListener, TcpStream};

use crate::{
    config::ConnectionsConfig,
    connections::{Connections, Guarded, Incoming},
    error::{Error, Result},
};

/// Where the pages' connections come in.
pub(super) struct Gate {
    incoming: Incoming<TcpStream>,
    address: SocketAddr,
}

impl Gate {
    pub(super) fn new(config: ConnectionsConfig, listener: TcpListener) -> Result<Self> {
        let address = listener.local_addr().map_err(|error| Error::internal("asking the pages' address", error))?;
        Ok(Self { incoming: Connections::new(config).plain(listener), address })
    }
}

impl Listener for Gate {
    type Io = Guarded<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, SocketAddr) {
        match self.incoming.next().await {
            Some(Ok(connection)) => {
                let peer = connection.link().peer();
                (connection, peer)
            }
            // It listens no more.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}
