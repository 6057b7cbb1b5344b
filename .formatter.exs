[
  inputs: ["{mix,.formatter,.iex}.exs", "config/*.exs", "test/**/*.{ex,exs}", "bench/**/*.exs"],
  subdirectories: ["apps/*"],
  line_length: 98
]
