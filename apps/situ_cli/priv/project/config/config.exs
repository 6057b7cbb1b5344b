import Config

config :logger, :console, metadata: [:pipeline, :component]
