"""Control of elastic robots: closed loops around the feedforward, their measures, benchmarks and tuning."""
