"""The paper's study of explanations on one graph: ablation, importance, shift, fidelity, agreement, hypotheses."""
