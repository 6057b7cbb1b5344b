defmodule Situ.CLI.Store.Sending do
  @moduledoc "The verbs of `situ store` that hand messages to other programs: save (a file), send (ZeroMQ)."
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.{Format, ZeroMQ}
  alias Situ.CLI.{Option, Output, Progress, Recording, Verb}
  alias Situ.{Error, Store}

  @formats %{
    "csv" => :csv,
    "json" => :json,
    "json_lines" => :json_lines,
    "message_pack" => :message_pack
  }
  @endings %{
    ".csv" => :csv,
    ".json" => :json,
    ".jsonl" => :json_lines,
    ".msgpack" => :message_pack
  }
  @recording [
    kind: :recording,
    doc: "a store's folder, ROOT/NAME for the newest NAME.NNNN, or a foreign file"
  ]
  @chunk 500

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "save"],
        aliases: ["export"],
        summary:
          "write the messages of a stream to a file that other programs read: CSV, JSON, MessagePack",
        about: "The layouts are those of Situ.Bridge.Format, which \\psi reads and writes too.",
        arguments: [
          path: @recording,
          file: [
            kind: :file,
            doc: "the file to write (.csv, .json, .jsonl, .msgpack); - for standard output"
          ]
        ],
        options: [
          stream(),
          format("the format, whatever the ending"),
          Option.new(:from, :time, "from this originating time on"),
          Option.new(:to, :time, "up to this originating time"),
          Option.new(
            :skip_damage,
            :flag,
            "leave out what is damaged; without it that is an error"
          )
        ],
        examples: [
          "situ store save recordings/lobby levels.csv -s Lobby.Level",
          "situ store save recordings/lobby - -s Lobby.Level --format json_lines | jq .message"
        ],
        run: &save/2
      },
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

  defp save(%{path: path, file: file}, opts) do
    store = Recording.open!(path)
    info = chosen(store, opts[:stream])
    format = @formats[opts[:format]] || @endings[Path.extname(file)]

    unless format,
      do:
        throw(
          {:usage,
           "in which format? Give --format, or a file that ends in .csv, .json, .jsonl or .msgpack"}
        )

    module = Format.module!(format)
    messages = Store.messages(store, info, reading(opts))
    out = out(file)

    n =
      Progress.show("save", opts, fn progress ->
        written(messages, module, format, {out, info.count, progress})
      end)

    if opts[:json] && file != "-", do: Output.json(%{file: file, messages: n, format: format})
    0
  end

  defp reading(opts), do: [skip_damage: opts[:skip_damage]] ++ Keyword.take(opts, [:from, :to])

  # A record that cannot be written ends it, and a file that is not whole does not stay.
  defp written(messages, module, format, {out, total, progress}) do
    n =
      messages
      |> Stream.chunk_every(@chunk)
      |> Enum.reduce(0, fn batch, n ->
        {records, n} =
          Enum.map_reduce(batch, n, &{module.record(&1.data, &1.originating_time, &2), &2 + 1})

        put(out, records)
        progress.(n, total)
        n
      end)

    put(out, module.finish(n))
    close(out)
    n
  catch
    {:not_writable, what} ->
      discard(out)
      raise Format.not_writable(format, what)
  end

  # Written beside the file and renamed when it is whole; standard output goes past the VM's slow way to it.
  defp out("-"), do: {:stdout, open!("/dev/stdout", [:append])}
  defp out(path), do: {path, open!(path <> ".unfinished", [:write])}

  defp open!(path, modes) do
    case :file.open(path, [:raw, :binary | modes]) do
      {:ok, device} ->
        device

      {:error, reason} ->
        raise Error.new(:not_saved, "cannot write #{path}",
                why: to_string(:file.format_error(reason))
              )
    end
  end

  defp put({_, device} = out, bytes) do
    case :file.write(device, bytes) do
      :ok ->
        :ok

      {:error, :epipe} ->
        exit(:terminated)

      {:error, reason} ->
        discard(out)

        raise Error.new(:not_saved, "the file cannot be written",
                why: to_string(:file.format_error(reason)),
                fix: "make room, or write elsewhere"
              )
    end
  end

  defp close({:stdout, device}), do: :file.close(device)

  defp close({path, device}) do
    with :ok <- :file.close(device), :ok <- File.rename(path <> ".unfinished", path) do
      :ok
    else
      {:error, reason} ->
        raise Error.new(:not_saved, "cannot write #{path}",
                why: to_string(:file.format_error(reason))
              )
    end
  end

  defp discard({:stdout, _}), do: :ok

  defp discard({path, device}) do
    _ = :file.close(device)
    _ = File.rm(path <> ".unfinished")
    :ok
  end

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
