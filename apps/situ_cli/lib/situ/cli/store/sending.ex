defmodule Situ.CLI.Store.Sending do
  @moduledoc "The verbs of `situ store` that hand messages to running programs: send (ZeroMQ)."
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.ZeroMQ
  alias Situ.CLI.{Option, Output, Recording, Verb}
  alias Situ.{Error, Store}

  @formats %{
    "csv" => :csv,
    "json" => :json,
    "json_lines" => :json_lines,
    "message_pack" => :message_pack
  }
  @recording [
    kind: :recording,
    doc: "a store's folder, ROOT/NAME for the newest NAME.NNNN, or a foreign file"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "send"],
        aliases: ["play"],
        summary: "replay a stream to other programs: published by ZeroMQ",
        arguments: [path: @recording],
        options: [
          stream(),
          Option.new(:address, :string, "where subscribers connect",
            short: :a,
            value: "ADDRESS",
            default: "tcp://127.0.0.1:5555"
          ),
          Option.new(:topic, :string, "the topic", short: :t, default: ""),
          format("of the messages"),
          Option.new(:speed, :float, "1.0 is the speed of the recording; 0 as fast as possible",
            value: "X",
            default: 1.0
          ),
          Option.new(
            :subscribers,
            :integer,
            "wait for so many subscribers before the first message",
            default: 1
          )
        ],
        examples: ["situ store send recordings/lobby -s Lobby.Level -t level --speed 2"],
        run: &send_out/2
      }
    ]
  end

  defp stream,
    do:
      Option.new(:stream, :string, "the stream (default: the only one)", short: :s, value: "NAME")

  defp format(doc), do: Option.new(:format, @formats |> Map.keys() |> Enum.sort(), doc, short: :m)

  defp chosen(store, nil) do
    case Store.streams(store) do
      [one] ->
        one

      several ->
        raise Error.new(:ambiguous_stream, "#{store.path} has #{length(several)} streams",
                fix:
                  "choose by --stream: #{several |> Enum.take(8) |> Enum.map_join(", ", & &1.name)}"
              )
    end
  end

  defp chosen(store, name) do
    case Store.stream_info(store, name) do
      {:ok, info} -> info
      {:error, error} -> raise error
    end
  end

  defp send_out(%{path: path}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    store = Recording.open!(path)
    info = chosen(store, opts[:stream])
    format = @formats[opts[:format] || "json"]
    speed = if opts[:speed] == 0.0, do: :max, else: opts[:speed]

    result =
      Situ.Pipeline.run(
        fn p ->
          p
          |> Store.importer(store)
          |> Store.stream(info.name)
          |> ZeroMQ.publish(opts[:address],
            topic: opts[:topic],
            format: format,
            wait_for: opts[:subscribers]
          )
        end,
        pipeline: [replay: [speed: speed]]
      )

    case result do
      {:ok, _} ->
        if opts[:json],
          do: Output.json(%{stream: info.name, messages: info.count, address: opts[:address]})

        0

      {:error, error} ->
        raise error
    end
  end
end
