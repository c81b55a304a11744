"""Code generation: expressions and loops as text of LLVM, C99 for a vehicle."""
