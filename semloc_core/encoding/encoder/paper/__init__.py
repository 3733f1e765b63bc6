"""The paper's encoder: sum message passing and GATv2 (Section IV-B.1)."""
