import Config

# Libraries take options, not configuration; what stands here is the logger's shape only.
config :logger, :console,
  format: "$time $metadata[$level] $message\n",
  metadata: [:pipeline, :component]

import_config "#{config_env()}.exs"
