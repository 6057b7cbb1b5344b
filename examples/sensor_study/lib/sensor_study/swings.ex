defmodule SensorStudy.Swings do
  @moduledoc """
  A task over the sessions of a dataset: proposes an annotation for each swing of the leg, from the angular velocity
  about the axis of the hip and the knee.
  """
  @behaviour Situ.Dataset.Task

  alias Situ.Annotation.{Schema, Segmenting}
  alias Situ.{Store, Time}

  @impl true
  def task do
    %{
      name: "swings",
      about: "proposes the swings of a leg, from its angular velocity",
      output: "Swings",
      options: [
        stream: [type: :string, default: "z", doc: "The angular velocity, in rad/s."],
        above: [type: :number, default: 1.0, doc: "The angular velocity of a swing, in rad/s."],
        smooth: [type: :time_ns, default: Time.ms(100), doc: "The span of the average."]
      ]
    }
  end

  @doc "Returns the schema of the annotations."
  @spec schema() :: Schema.t()
  def schema, do: Schema.finite("Phase", ["swing", "stumble"])

  @impl true
  def build(_p, opts) do
    velocity =
      Situ.average(opts[:open].(opts[:stream]), over: {:past, opts[:smooth]}, name: "Velocity")

    opts[:write].(velocity, "Velocity")

    velocity
    |> Situ.map(&(&1 > opts[:above]), type: :boolean)
    |> Segmenting.from_booleans(
      track: "leg",
      values: %{"Phase" => "swing"},
      proposed: true,
      by: "swings"
    )
    |> Store.write(opts[:exporter], "Gait", metadata: Schema.to_json(schema()))
  end
end
