//! The pages' listener: connections under the same watch as those of calls, and encrypted like them. Each carries one
//! request.

use std::{io, net::SocketAddr, sync::Arc};

use axum::{
    extract::connect_info::Connected,
    serve::{IncomingStream, Listener},
};
use futures::StreamExt as _;
use tokio::net::TcpListener;

use crate::{
    access::tls::{self, Line, Tls},
    connections::{self, Connections, Guarded, Incoming, Link},
    error::{Error, Result},
};

/// Where the pages' connections come in.
pub(super) struct Gate {
    incoming: Incoming<Line>,
    address: SocketAddr,
}

impl Gate {
    pub(super) fn new(connections: &Connections, listener: TcpListener, tls: Option<Arc<Tls>>) -> Result<Self> {
        let address = listener.local_addr().map_err(|error| Error::internal("asking the pages' address", error))?;
        let incoming =
            connections::incoming(connections, listener, move |stream| tls::handshake_of_pages(tls.clone(), stream));
        Ok(Self { incoming, address })
    }
}

impl Listener for Gate {
    type Io = Guarded<Line>;
    type Addr = Link;

    async fn accept(&mut self) -> (Self::Io, Link) {
        match self.incoming.next().await {
            Some(Ok(connection)) => {
                let link = connection.link().clone();
                (connection, link)
            }
            // It listens no more.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<Link> {
        Ok(Link::new(self.address))
    }
}

impl Connected<IncomingStream<'_, Gate>> for Link {
    fn connect_info(stream: IncomingStream<'_, Gate>) -> Self {
        stream.remote_addr().clone()
    }
}
