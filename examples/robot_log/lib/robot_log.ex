defmodule RobotLog do
  @moduledoc """
  Finds the moments of a robot's log that are worth a look: shocks, and topics that fell silent. Also computes the
  robot's speed from its positions.
  """
  use Situ.Pipeline,
    options: [
      input: [
        type: {:optional, :string},
        default: nil,
        doc: "A ROS bag or MCAP file. By default, the one in priv/."
      ],
      shock: [
        type: :number,
        default: 5.0,
        doc: "The acceleration of a shock in addition to gravity, in m/s2."
      ],
      silence: [
        type: :number,
        default: 1.9,
        doc: "A topic is silent if a message takes this many times longer than on average."
      ]
    ]

  alias RobotLog.{Moments, Silence}
  alias Situ.{Geo, Store, Time, Vector3}

  @gravity 9.81

  @impl true
  def build(p, opts) do
    path = opts[:input] || Application.app_dir(:robot_log, "priv/drive.bag")
    bag = Store.importer(p, path)
    imu = Store.stream(bag, "/imu/data_raw")
    positions = Store.stream(bag, "/gps/fix")

    bag |> Store.stream("/camera/image/compressed") |> Situ.name("Camera")
    Situ.window(positions, -1..0, &speed/1, with: :messages, type: :float, name: "Speed")

    imu
    |> Situ.map(&abs(Vector3.norm(&1.acceleration) - @gravity), type: :float, name: "Acceleration")
    |> Situ.via(Moments, above: opts[:shock], join: Time.ms(200), name: "Shock")
    |> Situ.each(&print_moment("shock", &1))

    for {topic, stream} <- [imu: imu, gps: positions] do
      stream
      |> Situ.via(Silence, factor: opts[:silence], name: "Silence.#{topic}")
      |> Situ.each(&print_moment("#{topic} was silent", &1))
    end
  end

  defp speed([a, b]) do
    distance = Geo.distance(coordinates(a.data), coordinates(b.data))
    distance / Time.to_seconds(b.originating_time - a.originating_time)
  end

  defp coordinates(position), do: {position.latitude, position.longitude, position.height}

  defp print_moment(what, %{left: from, right: to}) do
    IO.puts("#{Time.to_iso8601(from)}  #{what} for #{Time.format_duration(to - from)}")
  end
end
