//! Disjoint sets of numbers: which nodes of a graph are connected.

/// Sets of the numbers from 0 on; each is called by its smallest one.
pub(crate) struct DisjointSets {
    parent: Vec<usize>,
}

impl DisjointSets {
    /// `n` sets of one number each.
    pub(crate) fn new(n: usize) -> Self {
        Self { parent: (0..n).collect() }
    }

    /// The smallest number of the set of `i`.
    pub(crate) fn find(&mut self, mut i: usize) -> usize {
        while self.parent[i] != i {
            self.parent[i] = self.parent[self.parent[i]];
            i = self.parent[i];
        }
        i
    }

    /// Joins the sets of `a` and `b`; whether they were two.
    pub(crate) fn join(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b)] = a.min(b);
        a != b
    }

    /// How many numbers there are in the set called by each; 0 for those that call none.
    pub(crate) fn sizes(&mut self) -> Vec<usize> {
        let mut sizes = vec![0; self.parent.len()];
        (0..self.parent.len()).for_each(|i| sizes[self.find(i)] += 1);
        sizes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_joined_and_called_by_their_smallest_number() {
        let mut sets = DisjointSets::new(6);
        assert!(sets.join(4, 2) && sets.join(5, 4) && sets.join(0, 1));
        assert!(!sets.join(2, 5));
        assert_eq!([4, 5, 1, 3].map(|i| sets.find(i)), [2, 2, 0, 3]);
        assert_eq!(sets.sizes(), [2, 0, 3, 1, 0, 0]);
        assert!(DisjointSets::new(0).sizes().is_empty());
    }
}
