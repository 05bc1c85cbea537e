"""Networks: multilayer perceptron, angle embedding, structured Lagrangian."""
