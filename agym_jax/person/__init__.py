"""The person: sizes, limits of the joints, muscles, and how a population is drawn."""
