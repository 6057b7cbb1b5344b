import Config

# A release starts the pipeline. `situ run`, `mix test` and `situ iex` do not.
if config_env() == :prod do
  recordings = System.get_env("{{APP}}_RECORDINGS", "recordings")
  port = String.to_integer(System.get_env("{{APP}}_PORT", "4040"))

  config :{{app}},
    children: [
      {{{Module}}, recordings: recordings, pipeline: [name: "{{Module}}"]},
      {Situ.Studio, path: recordings, pipelines: [{"{{Module}}", "{{Module}}"}], port: port}
    ]
end
