defmodule {{Module}} do
  @moduledoc """
  A task over the sessions of a dataset: writes a stream of booleans, which are true where a stream of numbers is above
  a threshold.

      situ task run study.json lib/{{path}}.ex --set stream=Level --set threshold=0.5
  """
  @behaviour Situ.Dataset.Task

  @impl true
  def task do
    %{
      name: "{{name}}",
      about: "marks where a stream of numbers is above a threshold",
      output: "{{Last}}",
      options: [
        stream: [type: :string, required: true, doc: "The stream of numbers."],
        threshold: [type: :float, default: 0.5, doc: "The threshold."]
      ]
    }
  end

  @impl true
  def build(_p, opts) do
    opts[:open].(opts[:stream])
    |> Situ.map(&(&1 > opts[:threshold]), type: :boolean)
    |> opts[:write].("{{Last}}")
  end
end
