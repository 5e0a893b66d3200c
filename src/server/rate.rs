//! How much one client may ask for.
//!
//! A client has an allowance, which fills up again as time goes by. What reads costs one of it,
//! what writes costs [`WRITE`], and a piece of an upload [`PIECE`].

use std::fmt;
use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::keyed::DefaultKeyedStateStore;
use governor::{Quota, RateLimiter};

/// What a request costs that only reads.
pub const READ: NonZeroU32 = NonZeroU32::MIN;
/// What a request costs that changes something.
pub const WRITE: NonZeroU32 = NonZeroU32::new(10).expect("not zero");
/// What a request costs that begins an upload in pieces or adds one: there are many of them, and
/// the bytes cost their sender more than the server.
pub const PIECE: NonZeroU32 = NonZeroU32::new(2).expect("not zero");
/// After so many requests those clients are forgotten whose allowance is whole.
const FORGET_EVERY: u32 = 4096;

type Limiter =
    RateLimiter<Client, DefaultKeyedStateStore<Client>, DefaultClock, StateInformationMiddleware>;

/// Who is counted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Client {
    /// Whoever shows tokens of this owner.
    Owner(String),
    /// Whoever has no token that holds.
    Address(IpAddr),
    /// The same, where they log in or out: nobody's other requests are in the way.
    Login(IpAddr),
}

/// What a client has left, after what it asked for was taken away or refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// What it has when it has not asked for a while.
    pub most: u32,
    /// What is left.
    pub left: u32,
    /// Until all of it is there again.
    pub whole_in: Duration,
    /// Time in which `most` comes back.
    pub window: Duration,
    /// For a request that is refused: until it would not be.
    pub wait: Option<Duration>,
}

/// The allowances of all clients.
pub struct Rates {
    limiter: Option<Limiter>,
    most: u32,
    /// Comes back in a second.
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
    /// `rate` comes back in a second, until there are `most`; at least what one write costs. A rate
    /// of 0 limits nobody.
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

    /// Takes `cost` from a client's allowance, or tells how long it has to wait; `None` where
    /// nobody is limited.
    pub fn take(&self, client: &Client, cost: NonZeroU32) -> Option<Allowance> {
        let limiter = self.limiter.as_ref()?;
        if self.asked.fetch_add(1, Ordering::Relaxed) % FORGET_EVERY == FORGET_EVERY - 1 {
            limiter.retain_recent();
        }
        // An allowance holds at least one write, so that nothing is too much for ever.
        let taken = limiter.check_key_n(client, cost).ok()?;
        let (left, wait) = match taken {
            Ok(state) => (state.remaining_burst_capacity(), None),
            Err(refusal) => {
                let wait = refusal.wait_time_from(limiter.clock().now());
                // What it lacks comes back while it waits.
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
    fn an_allowance_is_used_up_and_comes_back() {
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
    fn clients_do_not_use_up_each_others_and_no_rate_is_no_limit() {
        let rates = Rates::new(1, 10);
        let address = Client::Address([192, 0, 2, 1].into());
        for client in [owner("anna"), owner("ben"), address] {
            assert_eq!(rates.take(&client, WRITE).expect("limited").wait, None);
            assert!(rates.take(&client, READ).expect("limited").wait.is_some());
        }
        assert_eq!(Rates::new(0, 10).take(&owner("anna"), WRITE), None);
    }

    #[test]
    fn clients_that_have_all_of_it_again_are_forgotten() {
        let rates = Rates::new(1_000_000, 10);
        for number in 0..FORGET_EVERY + 1 {
            rates.take(&owner(&number.to_string()), READ);
        }
        let limiter = rates.limiter.as_ref().expect("a limit");
        assert!(limiter.len() < 100, "{}", limiter.len());
    }
}
