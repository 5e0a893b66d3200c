//! A fair queue of renders: one at a time, the clients in turn.
//!
//! A client that asks for many pictures delays only itself: another client's first is made next.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

/// The turns for one resource. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    most: usize,
    queue: Arc<Mutex<Queue>>,
}

#[derive(Debug, Default)]
struct Queue {
    is_taken: bool,
    /// The waiting clients, in the order of their next turns; none is listed twice or without a
    /// request.
    clients: VecDeque<Waiting>,
}

#[derive(Debug)]
struct Waiting {
    client: IpAddr,
    asked: VecDeque<oneshot::Sender<Turn>>,
}

/// A turn. Dropping it passes it to the next client in the queue.
#[derive(Debug)]
pub(super) struct Turn(Turns);

impl Turns {
    /// At most `most` requests have or await a turn at a time.
    pub(super) fn new(most: usize) -> Self {
        Self { most, queue: Arc::default() }
    }

    /// Waits for a turn. Dropping the future leaves the queue.
    ///
    /// Returns `None` if too many wait: at once, or later, if this client has asked for more than
    /// its share and another client needs its place.
    pub(super) async fn take(&self, client: IpAddr) -> Option<Turn> {
        let awaited = {
            let mut queue = self.lock();
            if !queue.is_taken {
                queue.is_taken = true;
                return Some(Turn(self.clone()));
            }
            queue.forget_gone();
            if queue.len() >= self.most && !queue.make_room_for(client) {
                return None;
            }
            queue.push(client)
        };
        awaited.await.ok()
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let next = {
            let mut queue = self.0.lock();
            let next = queue.pop();
            queue.is_taken = next.is_some();
            next
        };
        if let Some(next) = next {
            // If the receiver has gone, the turn is dropped and passes to the next in the queue.
            drop(next.send(Turn(self.0.clone())));
        }
    }
}

impl Queue {
    /// The number of requests that have a turn or wait for one.
    fn len(&self) -> usize {
        let waiting: usize = self.clients.iter().map(|waiting| waiting.asked.len()).sum();
        waiting + usize::from(self.is_taken)
    }

    fn forget_gone(&mut self) {
        for waiting in &mut self.clients {
            waiting.asked.retain(|asked| !asked.is_closed());
        }
        self.clients.retain(|waiting| !waiting.asked.is_empty());
    }

    /// Takes the last place of the client with most, if it has more than `client` will have.
    fn make_room_for(&mut self, client: IpAddr) -> bool {
        let own = self.clients.iter().find(|waiting| waiting.client == client);
        let own = own.map_or(0, |waiting| waiting.asked.len());
        let most = self.clients.iter_mut().max_by_key(|waiting| waiting.asked.len());
        match most {
            Some(most) if most.asked.len() > own + 1 => most.asked.pop_back().is_some(),
            _ => false,
        }
    }

    fn push(&mut self, client: IpAddr) -> oneshot::Receiver<Turn> {
        let (sender, awaited) = oneshot::channel();
        let known = self.clients.iter_mut().find(|waiting| waiting.client == client);
        match known {
            Some(waiting) => waiting.asked.push_back(sender),
            None => self.clients.push_back(Waiting { client, asked: VecDeque::from([sender]) }),
        }
        awaited
    }

    /// The next request; its client moves to the end of the queue.
    fn pop(&mut self) -> Option<oneshot::Sender<Turn>> {
        let mut waiting = self.clients.pop_front()?;
        let next = waiting.asked.pop_front();
        if !waiting.asked.is_empty() {
            self.clients.push_back(waiting);
        }
        next
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::{Pin, pin};
    use std::task::{Context, Poll, Waker};

    use super::*;

    fn client(number: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, number])
    }

    fn poll<F: Future>(future: Pin<&mut F>) -> Poll<F::Output> {
        future.poll(&mut Context::from_waker(Waker::noop()))
    }

    /// Whether the future is pending.
    fn waits<F: Future>(future: &mut Pin<Box<F>>) -> bool {
        poll(future.as_mut()).is_pending()
    }

    #[test]
    fn clients_take_turns_and_each_keeps_its_order() {
        let turns = Turns::new(8);
        let Poll::Ready(Some(mut turn)) = poll(pin!(turns.take(client(1)))) else {
            panic!("it is free");
        };
        let mut waiting: Vec<_> = [1, 1, 1, 2, 3, 2]
            .map(|number| (number, Box::pin(turns.take(client(number)))))
            .into_iter()
            .collect();
        assert!(waiting.iter_mut().all(|(_, future)| waits(future)));
        let mut order = Vec::new();
        while !waiting.is_empty() {
            drop(turn);
            let mut ready = None;
            for (index, (_, future)) in waiting.iter_mut().enumerate() {
                if let Poll::Ready(next) = poll(future.as_mut()) {
                    assert!(ready.is_none(), "two have a turn");
                    ready = Some((index, next.expect("a turn")));
                }
            }
            let (index, next) = ready.expect("one has a turn");
            order.push(waiting.remove(index).0);
            turn = next;
        }
        assert_eq!(order, [1, 2, 3, 1, 2, 1]);
    }

    #[test]
    fn a_full_queue_makes_room_for_the_client_with_fewest_requests() {
        let turns = Turns::new(4);
        let turn = poll(pin!(turns.take(client(1))));
        let mut many: Vec<_> = (0..3).map(|_| Box::pin(turns.take(client(1)))).collect();
        assert!(many.iter_mut().all(waits));
        assert!(matches!(poll(pin!(turns.take(client(1)))), Poll::Ready(None)));
        let mut other = Box::pin(turns.take(client(2)));
        assert!(waits(&mut other));
        assert!(matches!(poll(many[2].as_mut()), Poll::Ready(None)), "the last");
        assert!(waits(&mut many[1]));
        // Now both clients have their share.
        assert!(matches!(poll(pin!(turns.take(client(2)))), Poll::Ready(None)));
        drop(turn);
    }

    #[test]
    fn a_turn_outlives_a_client_that_leaves() {
        let turns = Turns::new(4);
        let turn = poll(pin!(turns.take(client(1))));
        let mut gone = Box::pin(turns.take(client(1)));
        let mut served = Box::pin(turns.take(client(2)));
        let mut last = Box::pin(turns.take(client(3)));
        assert!(waits(&mut gone) && waits(&mut served) && waits(&mut last));
        drop(gone);
        drop(turn);
        // The second request has a turn that it has not seen yet.
        drop(served);
        assert!(matches!(poll(last.as_mut()), Poll::Ready(Some(_))));
        assert!(matches!(poll(pin!(turns.take(client(1)))), Poll::Ready(Some(_))));
    }
}
