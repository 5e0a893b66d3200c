//! Rate limits of clients.
//!
//! A client has an allowance that refills over time. A reading request costs 1, a writing one
//! [`WRITE`], and a piece of an upload [`PIECE`].

use std::fmt;
use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::keyed::DefaultKeyedStateStore;
use governor::{Quota, RateLimiter};

/// Cost of a read request.
pub const READ: NonZeroU32 = NonZeroU32::MIN;
/// Cost of a write request.
pub const WRITE: NonZeroU32 = NonZeroU32::new(10).expect("not zero");
/// Cost of a request that begins a resumable upload or adds a piece: there are many, and their
/// bytes cost the sender more than the server.
pub const PIECE: NonZeroU32 = NonZeroU32::new(2).expect("not zero");
/// Number of requests after which clients with a full allowance are forgotten.
const FORGET_EVERY: u32 = 4096;

type Limiter =
    RateLimiter<Client, DefaultKeyedStateStore<Client>, DefaultClock, StateInformationMiddleware>;

/// The key by which requests are counted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Client {
    /// The owner of the presented token.
    Owner(String),
    /// The address of a client without a valid token.
    Address(IpAddr),
    /// As [`Client::Address`], for logins and logouts, so that other requests cannot block them.
    Login(IpAddr),
}

/// The remaining allowance of a client after a request was charged or refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// The full allowance.
    pub most: u32,
    /// The remaining allowance.
    pub left: u32,
    /// Time until the full allowance is restored.
    pub whole_in: Duration,
    /// Time in which `most` refills.
    pub window: Duration,
    /// For a refused request: how long to wait.
    pub wait: Option<Duration>,
}

/// The allowances of all clients.
pub struct Rates {
    limiter: Option<Limiter>,
    most: u32,
    /// Refill per second.
    rate: u32,
    asked: AtomicU32,
}

impl fmt::Debug for Rates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Rates")
            .field("most", &self.most)
            .field("rate", &self.rate)
            .finish_non_exhaustive()
    }
}

impl Rates {
    /// Refills `rate` per second up to `most`, which is at least the cost of a write. A rate of 0
    /// disables the limit.
    pub fn new(rate: u32, most: u32) -> Self {
        let most = most.max(WRITE.get());
        let quota = NonZeroU32::new(rate).map(Quota::per_second);
        let quota = quota.zip(NonZeroU32::new(most));
        Self {
            limiter: quota.map(|(quota, most)| {
                RateLimiter::keyed(quota.allow_burst(most))
                    .with_middleware::<StateInformationMiddleware>()
            }),
            most,
            rate,
            asked: AtomicU32::new(0),
        }
    }

    /// Takes `cost` from a client's allowance and returns the remainder, with a wait if the request
    /// is refused; `None` without a limit.
    pub fn take(&self, client: &Client, cost: NonZeroU32) -> Option<Allowance> {
        let limiter = self.limiter.as_ref()?;
        if self.asked.fetch_add(1, Ordering::Relaxed) % FORGET_EVERY == FORGET_EVERY - 1 {
            limiter.retain_recent();
        }
        // An allowance covers at least one write, so no request is refused forever.
        let taken = limiter.check_key_n(client, cost).ok()?;
        let (left, wait) = match taken {
            Ok(state) => (state.remaining_burst_capacity(), None),
            Err(refusal) => {
                let wait = refusal.wait_time_from(limiter.clock().now());
                // The missing part refills during the wait.
                let lacks = (wait.as_secs_f64() * f64::from(self.rate)).ceil() as u32;
                (cost.get().saturating_sub(lacks), Some(wait))
            }
        };
        let time = |units: u32| Duration::from_secs_f64(f64::from(units) / f64::from(self.rate));
        Some(Allowance {
            most: self.most,
            left,
            whole_in: time(self.most.saturating_sub(left)),
            window: time(self.most),
            wait,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner(name: &str) -> Client {
        Client::Owner(name.to_owned())
    }

    #[test]
    fn an_allowance_is_used_up_and_refills() {
        let rates = Rates::new(100, 30);
        let anna = owner("anna");
        let first = rates.take(&anna, WRITE).expect("limited");
        assert_eq!((first.most, first.left, first.wait), (30, 20, None));
        assert_eq!(first.window, Duration::from_millis(300));
        let left: Vec<_> = (0..40)
            .map_while(|_| rates.take(&anna, WRITE))
            .take_while(|allowance| allowance.wait.is_none())
            .collect();
        assert!((2..=4).contains(&left.len()), "{left:?}");
        let refused = rates.take(&anna, WRITE).expect("limited");
        let wait = refused.wait.expect("refused");
        assert!(wait <= Duration::from_millis(100), "{wait:?}");
        assert!(refused.left < WRITE.get() && refused.whole_in > Duration::ZERO);
        std::thread::sleep(wait + Duration::from_millis(5));
        assert_eq!(rates.take(&anna, WRITE).expect("limited").wait, None);
    }

    #[test]
    fn clients_are_limited_separately_and_a_rate_of_0_is_no_limit() {
        let rates = Rates::new(1, 10);
        let address = Client::Address([192, 0, 2, 1].into());
        for client in [owner("anna"), owner("ben"), address] {
            assert_eq!(rates.take(&client, WRITE).expect("limited").wait, None);
            assert!(rates.take(&client, READ).expect("limited").wait.is_some());
        }
        assert_eq!(Rates::new(0, 10).take(&owner("anna"), WRITE), None);
    }

    #[test]
    fn clients_with_a_full_allowance_are_forgotten() {
        let rates = Rates::new(1_000_000, 10);
        for number in 0..FORGET_EVERY + 1 {
            rates.take(&owner(&number.to_string()), READ);
        }
        let limiter = rates.limiter.as_ref().expect("a limit");
        assert!(limiter.len() < 100, "{}", limiter.len());
    }
}
