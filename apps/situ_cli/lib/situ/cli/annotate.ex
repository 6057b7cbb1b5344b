defmodule Situ.CLI.Annotate do
  @moduledoc "The verbs of `situ annotate`: import and export annotations, and measure the agreement of annotators."
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{Agreement, Exchange, Layer, Recording, Schema}
  alias Situ.CLI.{Input, Option, Output, Verb}
  alias Situ.{Error, Store, Time}

  @formats %{
    "eaf" => :eaf,
    "textgrid" => :textgrid,
    "webvtt" => :webvtt,
    "srt" => :srt,
    "label_studio" => :label_studio,
    "csv" => :csv,
    "coco" => :coco
  }
  @format_words @formats |> Map.keys() |> Enum.sort()

  @impl true
  def verbs do
    [
      %Verb{
        words: ["annotate", "info"],
        aliases: ["list"],
        summary: "list the annotation streams of a recording: tracks, counts, attributes",
        arguments: [path: [kind: :recording, doc: "a recording with annotations"]],
        examples: ["situ annotate info study/p01/annotation"],
        run: &info/2
      },
      %Verb{
        words: ["annotate", "export"],
        summary:
          "export an annotation stream for ELAN, Praat, players, Label Studio, spreadsheets, or as COCO",
        about: """
        The file's extension selects the format (.eaf, .TextGrid, .vtt, .srt, .json, .csv, .coco.json). The command
        lists the data that the format cannot hold.
        """,
        arguments: [
          path: [kind: :recording, doc: "a recording with annotations"],
          file: [kind: :file, doc: "the file to write; - for standard output, with --format"]
        ],
        options: [
          stream(),
          Option.new(:format, @format_words, "the format, regardless of the file's extension"),
          Option.new(
            :origin,
            :time,
            "the time that is zero in the file (default: the start of --media-of, else the first annotation)"
          ),
          Option.new(
            :media_of,
            :path,
            "the recording that the annotations are about: its first message is zero",
            value: "PATH"
          ),
          Option.new(:media, :path, "the video or audio file that the exported file refers to"),
          Option.new(
            :pictures,
            :string,
            "COCO: boxes on each image of this stream of --media-of, not only on key frames",
            value: "NAME"
          )
        ],
        examples: [
          "situ annotate export study/p01/annotation p01.eaf --media-of study/p01/room --media p01.mp4"
        ],
        run: &export/2
      },
      %Verb{
        words: ["annotate", "import"],
        summary:
          "create an annotation store from a file of ELAN, Praat, players, Label Studio or spreadsheets",
        about:
          "If a store of that name exists, it gets a new version; its other streams are copied.",
        arguments: [
          file: [kind: :file, doc: "the file to read; - for standard input, with --format"],
          out: [kind: :new, doc: "ROOT/NAME of the annotation store"]
        ],
        options: [
          stream(),
          Option.new(:format, @format_words, "the format, regardless of the file's extension"),
          Option.new(
            :schema,
            :path,
            "the schema to use (JSON); default: the file's own, or text"
          ),
          Option.new(
            :origin,
            :time,
            "the time that is zero in the file (default: the file's own statement, else 0)"
          ),
          Option.new(
            :media_of,
            :path,
            "the recording that the annotations are about: its first message is zero",
            value: "PATH"
          )
        ],
        examples: [
          "situ annotate import p01.TextGrid study/p01/annotation --media-of study/p01/room"
        ],
        run: &import_file/2
      },
      %Verb{
        words: ["annotate", "agreement"],
        summary: "compare two annotators: Cohen's kappa per frame, boundary errors",
        arguments: [
          first: [kind: :recording, doc: "annotations: a recording, or a file to import"],
          second: [kind: :recording, doc: "annotations of the other annotator"]
        ],
        options: [
          stream(),
          Option.new(:attribute, :string, "the attribute to compare (default: the first)",
            value: "NAME"
          ),
          Option.new(:track, :string, "only this track", many?: true, value: "NAME"),
          Option.new(:frame, :span, "the interval between compared times", default: 10_000_000),
          Option.new(:from, :time, "start of the compared span"),
          Option.new(:to, :time, "end of the compared span"),
          Option.new(:least, :float, "exit with status 1 if kappa is below this value")
        ],
        examples: ["situ annotate agreement anna/annotation ben.eaf --frame 40ms --least 0.8"],
        run: &agreement/2
      }
    ]
  end

  defp stream,
    do:
      Option.new(:stream, :string, "the annotation stream (default: the only one)",
        short: :s,
        value: "NAME"
      )

  defp info(%{path: path}, opts) do
    store = Situ.CLI.Recording.open!(path)
    layers = for {info, layer} <- layers(store), do: described(info.name, layer)
    if opts[:json], do: Output.json(layers), else: for(layer <- layers, do: text(layer))

    if layers == [] and not opts[:json],
      do: Output.puts("#{store.path} has no annotation streams.")

    0
  end

  defp layers(store) do
    for info <- Store.streams(store), Recording.annotations?(store, info) do
      {info, ok!(Recording.load(store, info))}
    end
  end

  defp described(name, layer) do
    all = Layer.annotations(layer)

    %{
      stream: name,
      schema: Schema.to_json(layer.schema),
      annotations: length(all),
      proposals: Enum.count(all, & &1.proposed?),
      tracks:
        for(
          track <- Layer.tracks(layer),
          do: %{name: track, annotations: length(Layer.on_track(layer, track))}
        )
    }
  end

  defp text(layer) do
    attributes = Enum.map_join(layer.schema["attributes"], ", ", &"#{&1["name"]} (#{&1["kind"]})")

    proposals =
      if layer.proposals > 0,
        do: ", #{Output.number(layer.proposals, "proposal")} among them",
        else: ""

    Output.puts(
      "#{Output.name(layer.stream)}: #{Output.number(layer.annotations, "annotation")}#{proposals}; #{attributes}"
    )

    for track <- layer.tracks,
        do: Output.puts("  #{Output.name(track.name)}: #{track.annotations}")
  end

  # Returns the named stream, or the recording's only annotation stream.
  defp chosen(store, nil) do
    case for info <- Store.streams(store), Recording.annotations?(store, info), do: info.name do
      [one] ->
        one

      [] ->
        raise Error.new(:no_stream, "#{store.path} has no annotation stream",
                fix: "run `situ store info` to list its streams"
              )

      several ->
        raise Error.new(
                :ambiguous_stream,
                "#{store.path} has #{length(several)} annotation streams",
                fix: "choose one with --stream: #{Enum.join(several, ", ")}"
              )
    end
  end

  defp chosen(_store, name), do: name

  defp export(%{path: path, file: file}, opts) do
    store = Situ.CLI.Recording.open!(path)
    layer = ok!(Recording.load(store, chosen(store, opts[:stream])))
    media = if(opts[:media], do: [media: opts[:media]], else: [])
    options = origin(opts) ++ media ++ pictures(opts[:pictures], opts)

    losses =
      if file == "-" do
        format = format(opts) || throw({:usage, "standard output needs a format: give --format"})

        {:ok, text, losses} = Exchange.encode(layer, format, options)
        Output.raw(text)
        losses
      else
        ok!(
          Exchange.write(layer, file, options ++ if(f = format(opts), do: [format: f], else: []))
        )
      end

    told(losses, opts, %{file: file, annotations: length(Layer.annotations(layer))}, file)
  end

  defp pictures(nil, _opts), do: []

  defp pictures(name, opts) do
    path =
      opts[:media_of] ||
        throw({:usage, "--pictures names a stream of --media-of: give both options"})

    messages = path |> Situ.CLI.Recording.open!() |> Store.messages(name, envelopes: true)
    [times: Enum.map(messages, & &1.originating_time)]
  end

  defp format(opts), do: opts[:format] && Map.fetch!(@formats, opts[:format])

  defp origin(opts) do
    cond do
      opts[:origin] -> [origin: opts[:origin]]
      opts[:media_of] -> [origin: first(opts[:media_of])]
      true -> []
    end
  end

  defp first(path) do
    case path |> Situ.CLI.Recording.open!() |> Store.interval() do
      {first, _} -> first
      nil -> raise Error.new(:empty, "#{path} has no messages", fix: "give --origin")
    end
  end

  defp told(losses, opts, report, out) do
    if opts[:json] and out != "-" do
      Output.json(Map.put(report, :losses, losses))
    else
      for loss <- losses, do: Output.warn("lost: #{loss}")
    end

    0
  end

  defp import_file(%{file: file, out: out}, opts) do
    schema = if opts[:schema], do: [schema: ok!(Schema.load(opts[:schema]))], else: []
    stream = opts[:stream] || "Annotation"
    options = schema ++ origin(opts) ++ [name: stream]

    {layer, losses} =
      if file == "-" do
        format = format(opts) || throw({:usage, "standard input needs a format: give --format"})
        read(Exchange.decode(Input.read(), format, options))
      else
        read(Exchange.read(file, options ++ if(f = format(opts), do: [format: f], else: [])))
      end

    others =
      if Store.exists?(out),
        do: Map.new(layers(Store.open!(out)), fn {i, l} -> {i.name, l} end),
        else: %{}

    path = ok!(Recording.write_all(Map.put(others, stream, layer), out))
    unless opts[:json], do: Output.puts(path)

    told(
      losses,
      opts,
      %{path: path, stream: stream, annotations: length(Layer.annotations(layer))},
      out
    )
  end

  defp read({:ok, layer, losses}), do: {layer, losses}
  defp read({:error, error}), do: raise(error)

  defp agreement(%{first: first, second: second}, opts) do
    [a, b] = for path <- [first, second], do: layer(path, opts[:stream])
    options = Keyword.take(opts, [:attribute, :frame, :from, :to])
    options = if opts[:track] == [], do: options, else: [{:tracks, opts[:track]} | options]
    report = ok!(Agreement.of(a, b, options))
    if opts[:json], do: Output.json(json(report)), else: shown(report)
    if opts[:least] && (report.kappa || 1.0) < opts[:least], do: 1, else: 0
  end

  # Accepts a recording or a file of another program.
  defp layer(path, stream) do
    with true <- File.regular?(path), {:ok, _} <- Exchange.format(path) do
      path |> Exchange.read(name: stream || "Annotation") |> read() |> elem(0)
    else
      _ ->
        store = Situ.CLI.Recording.open!(path)
        ok!(Recording.load(store, chosen(store, stream)))
    end
  end

  defp json(report) do
    confusion =
      for {{a, b}, n} <- Enum.sort(report.confusion), do: %{first: a, second: b, frames: n}

    %{report | confusion: confusion}
  end

  defp shown(report) do
    Output.puts(
      "#{Output.name(report.attribute)}: kappa #{number(report.kappa)}, " <>
        "agreement #{number(report.agreement)} of #{Output.number(report.frames, "frame")}"
    )

    for {track, kappa} <- Enum.sort(report.tracks),
        do: Output.puts("  #{Output.name(track)}: kappa #{number(kappa)}")

    Output.puts(
      "#{Output.number(report.paired, "pair")}; begins #{span(report.begin_error)} apart, " <>
        "ends #{span(report.end_error)}; " <>
        "#{report.only_first} only in the first, #{report.only_second} only in the second"
    )
  end

  defp number(nil), do: "-"
  defp number(x), do: :erlang.float_to_binary(x, decimals: 4)
  defp span(nil), do: "-"
  defp span(ns), do: Time.format_duration(round(ns))

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end
