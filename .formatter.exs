[
  inputs: [
    "{mix,.formatter,.iex}.exs",
    "config/*.exs",
    "test/**/*.{ex,exs}",
    "bench/**/*.exs",
    "integrations/*.exs",
    "integrations/*/{mix,.formatter}.exs",
    "integrations/*/{lib,test,examples}/**/*.{ex,exs}"
  ],
  subdirectories: ["apps/*"],
  line_length: 98
]
