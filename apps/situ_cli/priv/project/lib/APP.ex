defmodule {{Module}} do
  @moduledoc """
  Reports knocks: moments at which the level of a sensor rises above a threshold.
  """
  use Situ.Pipeline,
    options: [
      input: [
        type: {:optional, :string},
        default: nil,
        doc: "A recording or CSV file with numbers named level. By default, they are simulated."
      ],
      threshold: [type: :number, default: 0.6, doc: "The level of a knock, from 0 to 1."],
      quiet: [
        type: :time_ns,
        default: Situ.Time.ms(200),
        doc: "The shortest time between two knocks."
      ],
      recordings: [
        type: {:optional, :string},
        default: nil,
        doc: "The folder to record to. The last day is kept."
      ]
    ]

  alias Situ.{Store, Time}

  @impl true
  def build(p, opts) do
    store = opts[:recordings] && open_store(p, opts[:recordings])

    level = p |> read_level(opts[:input]) |> Store.write(store, "Level")

    level
    |> Situ.via({{Module}}.Knocks, name: "Knock", threshold: opts[:threshold], quiet: opts[:quiet])
    |> Store.write(store, "Knock")
    |> Situ.each(&print_knock/2)
  end

  defp open_store(p, folder) do
    Store.create(p, "{{app}}", folder, split: Time.h(1), keep: {:span, Time.h(24)})
  end

  # Fifty samples a second, with a knock now and then.
  defp read_level(p, nil) do
    p
    |> Situ.sequence(0, &(&1 + 1), every: Time.ms(20))
    |> Situ.map(&simulate_level/1, type: :float, name: "Level")
  end

  defp read_level(p, path) do
    p |> Store.importer(path) |> Store.stream("level") |> Situ.name("Level")
  end

  defp simulate_level(n) do
    knock = if rem(n, 90) < 8, do: 0.9 - 0.1 * rem(n, 90), else: 0.0
    max(knock, 0.1 + 0.05 * :math.sin(n / 3))
  end

  defp print_knock(level, message) do
    IO.puts("#{Time.to_iso8601(message.originating_time)}  knock, level #{Float.round(level, 2)}")
  end
end
