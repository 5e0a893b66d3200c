//! An S3 server that misbehaves on request, and stores on it.

use std::ops::Deref;
use std::path::PathBuf;
use std::time::Duration;

pub use fled_tests::Fault;
use fled_tests::S3;

use crate::Blobs;

pub struct Server(S3);

impl Deref for Server {
    type Target = S3;

    fn deref(&self) -> &S3 {
        &self.0
    }
}

impl Server {
    pub fn start() -> Self {
        Self(S3::start())
    }

    /// A store on this server, whose requests are retried for `patience`.
    pub fn blobs(&self, patience: Duration) -> Blobs {
        self.blobs_with("bucket/some/prefix", &[], patience)
    }

    /// Like [`Server::blobs`], but a request may stall for only one second.
    pub fn hasty_blobs(&self, patience: Duration) -> Blobs {
        let hasty = [("AWS_READ_TIMEOUT", "1 second")];
        self.blobs_with("bucket/some/prefix", &hasty, patience)
    }

    pub fn blobs_with(&self, place: &str, more: &[(&str, &str)], patience: Duration) -> Blobs {
        let settings = self.settings();
        let settings = settings.iter().chain(&[("HOME", "not ours")]).chain(more);
        let settings = settings.map(|&(name, value)| (name.to_owned(), value.to_owned()));
        Blobs::bucket(place, settings, patience).unwrap()
    }

    /// The folder of the objects of [`Server::blobs`].
    pub fn objects(&self) -> PathBuf {
        self.root().join("bucket/some/prefix")
    }

    /// Files of uploads that were neither completed nor aborted.
    pub fn unfinished(&self) -> Vec<String> {
        let mut names = super::names(self.root());
        names.retain(|name| name.starts_with(".upload"));
        names
    }
}
