"""Columns of what `row_kernels.update_rows` measures of each row; apart, to be read without Numba."""

LOG_EVIDENCE, NATS, ESS, HYPOTHESES, AGENT_UD, UD, FIT, AREA = range(8)
