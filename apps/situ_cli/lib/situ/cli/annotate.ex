defmodule Situ.CLI.Annotate do
  @moduledoc false
  # The verbs of `situ annotate`: import and export annotations, and measure the agreement of
  # annotators.
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{Agreement, Exchange, Layer, Recording, Schema}
  alias Situ.CLI.Annotate.{Report, Source}
  alias Situ.CLI.{Input, Option, Output, Verb}
  alias Situ.Dataset.SessionLayers
  alias Situ.{Error, Store}

  @formats %{
    "eaf" => :eaf,
    "textgrid" => :textgrid,
    "webvtt" => :webvtt,
    "srt" => :srt,
    "label_studio" => :label_studio,
    "csv" => :csv,
    "coco" => :coco,
    "mot" => :mot,
    "cvat" => :cvat
  }
  @format_words @formats |> Map.keys() |> Enum.sort()

  @impl true
  def verbs do
    [
      %Verb{
        words: ["annotate", "info"],
        aliases: ["list"],
        summary:
          "list the annotation streams of a recording or of sessions: tracks, counts, attributes",
        arguments: [
          path: [kind: :recording, doc: "a recording with annotations, or a dataset file"]
        ],
        options: [Source.session_option()],
        examples: ["situ annotate info study/p01/annotation", "situ annotate info study.json"],
        run: &show_info/2
      },
      %Verb{
        words: ["annotate", "export"],
        summary:
          "export an annotation stream for ELAN, Praat, players, Label Studio, spreadsheets, or as COCO",
        about: """
        The file's extension selects the format (.eaf, .TextGrid, .vtt, .srt, .json, .csv, .coco.json, .mot.txt,
        .cvat.xml). The command lists the data that the format cannot hold.
        """,
        arguments: [
          path: [kind: :recording, doc: "a recording with annotations, or a dataset file"],
          file: [kind: :file, doc: "the file to write; - for standard output, with --format"]
        ],
        options: [
          stream_option(),
          Source.session_option(),
          Option.new(:format, @format_words, "the format, regardless of the file's extension"),
          Option.new(
            :origin,
            :time,
            "time 0 of the file (default: the start of --media-of, of the session or the recording; " <>
              "else the first annotation)"
          ),
          Option.new(
            :media_of,
            :path,
            "the recording that the annotations describe; its first message becomes time 0",
            value: "PATH"
          ),
          Option.new(:media, :path, "the video or audio file that the exported file refers to"),
          Option.new(
            :pictures,
            :string,
            "COCO, MOT, CVAT: boxes on each image of this stream of --media-of, not only on key frames",
            value: "NAME"
          )
        ],
        examples: [
          "situ annotate export study/p01/annotation p01.eaf --media-of study/p01/room --media p01.mp4",
          "situ annotate export study.json p01.eaf --session p01 --stream Speech.Ada"
        ],
        run: &export_layer/2
      },
      %Verb{
        words: ["annotate", "import"],
        summary:
          "create an annotation store from a file of ELAN, Praat, players, Label Studio or spreadsheets",
        about: """
        If a store of that name exists, a new version is created, with copies of its other streams. If OUT is a dataset
        file, the annotations become a layer of a session.
        """,
        arguments: [
          file: [kind: :file, doc: "the file to read; - for standard input, with --format"],
          out: [kind: :new, doc: "ROOT/NAME of the annotation store, or a dataset file"]
        ],
        options: [
          stream_option(),
          Source.session_option(),
          Option.new(:format, @format_words, "the format, regardless of the file's extension"),
          Option.new(
            :schema,
            :path,
            "the schema to use (JSON); default: the file's own, or text"
          ),
          Option.new(
            :origin,
            :time,
            "the time that is 0 in the file (default: as stated in the file, else 0)"
          ),
          Option.new(
            :media_of,
            :path,
            "the recording that the annotations describe; its first message is time 0 of the file",
            value: "PATH"
          ),
          Option.new(
            :pictures,
            :string,
            "MOT, CVAT: the file counts the images of this stream of --media-of",
            value: "NAME"
          )
        ],
        examples: [
          "situ annotate import p01.TextGrid study/p01/annotation --media-of study/p01/room",
          "situ annotate import p01.eaf study.json --session p01 --stream Speech.Ben"
        ],
        run: &import_file/2
      },
      %Verb{
        words: ["annotate", "agreement"],
        summary: "compare two annotators: Cohen's kappa per frame, boundary errors",
        arguments: [
          first: [
            kind: :recording,
            doc: "annotations: a recording, a dataset file, or a file to import"
          ],
          second: [kind: :recording, doc: "annotations of the other annotator"]
        ],
        options: [
          stream_option(),
          Option.new(
            :second_stream,
            :string,
            "the stream of SECOND (default: the same as --stream)",
            value: "NAME"
          ),
          Source.session_option(),
          Option.new(:attribute, :string, "the attribute to compare (default: the first)",
            value: "NAME"
          ),
          Option.new(:track, :string, "only this track", many?: true, value: "NAME"),
          Option.new(:frame, :span, "the interval between compared times", default: 10_000_000),
          Option.new(:from, :time, "start of the compared span"),
          Option.new(:to, :time, "end of the compared span"),
          Option.new(:least, :float, "exit with status 1 if kappa is below this value")
        ],
        examples: [
          "situ annotate agreement anna/annotation ben.eaf --frame 40ms --least 0.8",
          "situ annotate agreement study.json study.json --session p01 -s Speech.Ada --second-stream Speech.Ben"
        ],
        run: &compare_annotators/2
      }
    ]
  end

  defp stream_option,
    do:
      Option.new(:stream, :string, "the annotation stream (default: the only one)",
        short: :s,
        value: "NAME"
      )

  defp show_info(%{path: path}, opts) do
    layers =
      for {session, source} <- Source.open_all!(path, opts[:session]),
          name <- Source.list_streams(source),
          do:
            name
            |> Report.describe_layer(Source.load_layer!(source, name))
            |> put_session(session)

    if opts[:json],
      do: Output.print_json(layers),
      else: for(layer <- layers, do: Report.print_layer(layer))

    if layers == [] and not opts[:json], do: Output.puts("#{path} has no annotation streams.")
    0
  end

  defp put_session(layer, nil), do: layer
  defp put_session(layer, session), do: Map.put(layer, :session, session)

  defp load_layers(store) do
    for info <- Store.streams(store), Recording.annotation_stream?(store, info) do
      {info, Error.unwrap!(Recording.load_layer(store, info))}
    end
  end

  defp export_layer(%{path: path, file: file}, opts) do
    source = Source.open!(path, opts[:session])
    layer = Source.load_layer!(source, opts[:stream])
    media = if(opts[:media], do: [media: opts[:media]], else: [])
    options = origin_option(opts, source) ++ media ++ image_times(opts[:pictures], opts)

    losses =
      if file == "-" do
        format =
          file_format(opts) || throw({:usage, "standard output needs a format: give --format"})

        {:ok, text, losses} = Exchange.encode(layer, format, options)
        Output.write_raw(text)
        losses
      else
        Error.unwrap!(
          Exchange.write(
            layer,
            file,
            options ++ if(f = file_format(opts), do: [format: f], else: [])
          )
        )
      end

    report_losses(
      losses,
      opts,
      %{file: file, annotations: length(Layer.annotations(layer))},
      file
    )
  end

  defp image_times(nil, _opts), do: []

  defp image_times(name, opts) do
    path =
      opts[:media_of] ||
        throw({:usage, "--pictures names a stream of --media-of: give both options"})

    messages = path |> Situ.CLI.Recording.open!() |> Store.messages(name, envelopes: true)
    [times: Enum.map(messages, & &1.originating_time)]
  end

  defp file_format(opts), do: opts[:format] && Map.fetch!(@formats, opts[:format])

  defp origin_option(opts, source) do
    cond do
      opts[:origin] -> [origin: opts[:origin]]
      opts[:media_of] -> [origin: Source.first_time!(opts[:media_of])]
      start = source && Source.start_time(source) -> [origin: start]
      true -> []
    end
  end

  defp report_losses(losses, opts, report, out) do
    if opts[:json] and out != "-" do
      Output.print_json(Map.put(report, :losses, losses))
    else
      for loss <- losses, do: Output.warn("lost: #{loss}")
    end

    0
  end

  defp import_file(%{file: file, out: out}, opts) do
    schema = if opts[:schema], do: [schema: Error.unwrap!(Schema.load(opts[:schema]))], else: []
    stream = opts[:stream] || "Annotation"
    target = if Source.dataset?(out), do: Source.open!(out, opts[:session])
    times = image_times(opts[:pictures], opts)
    options = schema ++ origin_option(opts, target) ++ times ++ [name: stream]

    {layer, losses} =
      if file == "-" do
        format =
          file_format(opts) || throw({:usage, "standard input needs a format: give --format"})

        unwrap_layer(Exchange.decode(Input.read_all(), format, options))
      else
        unwrap_layer(
          Exchange.read(file, options ++ if(f = file_format(opts), do: [format: f], else: []))
        )
      end

    path = store_layer(target, layer, stream, out)
    unless opts[:json], do: Output.puts(path)

    report_losses(
      losses,
      opts,
      %{path: path, stream: stream, annotations: length(Layer.annotations(layer))},
      out
    )
  end

  defp store_layer({:session, open}, layer, stream, out) do
    dataset = Source.open_dataset!(out)
    name = open.session.name
    dataset = Error.unwrap!(SessionLayers.create_layer(dataset, name, stream, layer))
    Error.unwrap!(SessionLayers.store_path(dataset, name))
  end

  defp store_layer(nil, layer, stream, out) do
    others =
      if Store.exists?(out),
        do: Map.new(load_layers(Store.open!(out)), fn {i, l} -> {i.name, l} end),
        else: %{}

    Error.unwrap!(Recording.write_all(Map.put(others, stream, layer), out))
  end

  defp unwrap_layer({:ok, layer, losses}), do: {layer, losses}
  defp unwrap_layer({:error, error}), do: raise(error)

  defp compare_annotators(%{first: first, second: second}, opts) do
    a = load_layer(first, opts[:stream], opts)
    b = load_layer(second, opts[:second_stream] || opts[:stream], opts)
    options = Keyword.take(opts, [:attribute, :frame, :from, :to])
    options = if opts[:track] == [], do: options, else: [{:tracks, opts[:track]} | options]
    report = Error.unwrap!(Agreement.compare_layers(a, b, options))

    if opts[:json],
      do: Output.print_json(Report.report_to_json(report)),
      else: Report.print_report(report)

    if opts[:least] && (report.kappa || 1.0) < opts[:least], do: 1, else: 0
  end

  # Accepts a recording, a session, or a file of another program.
  defp load_layer(path, stream, opts) do
    with true <- File.regular?(path) and not Source.dataset?(path),
         {:ok, _} <- Exchange.detect_format(path) do
      path |> Exchange.read(name: stream || "Annotation") |> unwrap_layer() |> elem(0)
    else
      _ ->
        session = if Source.dataset?(path), do: opts[:session]
        path |> Source.open!(session) |> Source.load_layer!(stream)
    end
  end
end
