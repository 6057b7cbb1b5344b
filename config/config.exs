import Config

# Libraries take options, not configuration; so this file only sets the format of log lines.
config :logger, :console,
  format: "$time $metadata[$level] $message\n",
  metadata: [:pipeline, :component]

import_config "#{config_env()}.exs"
