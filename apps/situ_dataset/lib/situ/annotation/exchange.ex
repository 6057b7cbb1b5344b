defmodule Situ.Annotation.Exchange do
  @moduledoc """
  Reads annotations from other programs' files and writes them.

  | format | extensions | read and written by | not stored |
  |---|---|---|---|
  | `:eaf` | `.eaf` | ELAN | times below 1 ms, confidence, notes, proposals |
  | `:textgrid` | `.TextGrid` | Praat | annotators, confidence, notes, proposals, empty labels |
  | `:webvtt` | `.vtt` | browsers, players | times below 1 ms, annotators, confidence, notes; points last 1 ms |
  | `:srt` | `.srt` | players | same as WebVTT |
  | `:label_studio` | `.json` | Label Studio | notes |
  | `:csv` | `.csv` | spreadsheets | nothing |
  | `:mot` | `.mot.txt` | trackers (MOT Challenge) | names of tracks, other annotations than boxes |
  | `:cvat` | `.cvat.xml` | CVAT (for videos) | confidence, notes, other annotations than boxes |
  | `:coco` | `.coco.json` | training of detectors | annotations without a box, key frame flags (with `times:`) |

  `write/3` and `read/2` return a list of sentences that describe the lost data; it is empty if nothing was lost.

      iex> alias Situ.Annotation.{Exchange, Layer, Schema}
      iex> hi = Situ.Annotation.new(1_000_000_000, 2_500_000_000, "P1", %{"Words" => "Hi"})
      iex> {:ok, layer} = Layer.new(Schema.text("Words"), [hi])
      iex> {:ok, text, []} = Exchange.encode(layer, :webvtt, origin: 0)
      iex> text |> String.split("\\n") |> Enum.drop(2)
      ["1", "00:00:01.000 --> 00:00:02.500", "<v P1>Hi</v>", ""]
      iex> {:ok, again, []} = Exchange.decode(text, :webvtt, schema: Schema.text("Words"))
      iex> Layer.annotations(again) == Layer.annotations(layer)
      true

  ELAN's tiers are the tiers of a schema (`Situ.Annotation.Schema`), with their parents, relations and vocabularies.
  ELAN and Praat store one text per interval. A schema with several attributes therefore becomes one row per track and
  attribute, called `TRACK.ATTRIBUTE`. Reading with the same schema joins these rows again.

  Files are untrusted input: they may have at most 64 MB, XML with a document type is rejected, and reading never
  creates atoms.
  """

  @formats %{
    eaf: Situ.Annotation.Exchange.Elan,
    textgrid: Situ.Annotation.Exchange.TextGrid,
    webvtt: Situ.Annotation.Exchange.WebVtt,
    srt: Situ.Annotation.Exchange.Srt,
    label_studio: Situ.Annotation.Exchange.LabelStudio,
    csv: Situ.Annotation.Exchange.Csv,
    coco: Situ.Annotation.Exchange.Coco,
    mot: Situ.Annotation.Exchange.Mot,
    cvat: Situ.Annotation.Exchange.Cvat
  }
  @options [
    format: [
      type: {:in, [:eaf, :textgrid, :webvtt, :srt, :label_studio, :csv, :coco, :mot, :cvat]},
      doc: "The file format. Default: detected by the file extension."
    ],
    origin: [
      type: :integer,
      doc:
        "The time (ns) of the file's zero. Default: the first start (writing), or the file's origin or 0 (reading)."
    ],
    schema: [
      type: {:struct, Situ.Annotation.Schema},
      doc:
        "Reading: the schema to use. Default: the schema in the file, or a schema guessed from the values."
    ],
    name: [
      type: :string,
      default: "Annotation",
      doc: "Reading: the name of a guessed schema."
    ],
    media: [
      type: :string,
      doc: "Writing: the video or audio file that is annotated, for formats that name one."
    ],
    times: [
      type: {:list, :integer},
      doc:
        "COCO, MOT and CVAT: the times (ns) of the images. Writing: they get boxes; default: the times of the key " <>
          "frames. Reading MOT and CVAT: default: the times in the file, or every 40 ms."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @options)

  alias Situ.Annotation.Exchange.LayerBuilder
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.{Error, Options}

  @largest 64 * 1024 * 1024
  @endings %{
    ".eaf" => :eaf,
    ".textgrid" => :textgrid,
    ".vtt" => :webvtt,
    ".srt" => :srt,
    ".coco.json" => :coco,
    ".mot.txt" => :mot,
    ".cvat.xml" => :cvat,
    ".json" => :label_studio,
    ".csv" => :csv
  }

  @type format ::
          :eaf | :textgrid | :webvtt | :srt | :label_studio | :csv | :coco | :mot | :cvat
  @type losses :: [String.t()]

  @doc "Encodes a layer as the text of a file. Times are relative to `origin:`. The losses describe all omitted data."
  @callback encode(Layer.t(), opts :: keyword()) :: {iodata(), losses()}
  @doc "Decodes the text of a file to its annotations and its schema (if it has one), or returns the reason in words."
  @callback decode(binary(), opts :: keyword()) ::
              {:ok, Schema.t() | nil, [Situ.Annotation.t()], losses()} | {:error, String.t()}

  @doc "Returns the format of a file by its extension. Error: `:unknown_format`."
  @spec detect_format(Path.t()) :: {:ok, format()} | {:error, Error.t()}
  def detect_format(path) do
    name = path |> Path.basename() |> String.downcase()

    # The longest extension takes precedence: `.coco.json` before `.json`.
    case @endings
         |> Enum.filter(&String.ends_with?(name, elem(&1, 0)))
         |> Enum.sort_by(&(-byte_size(elem(&1, 0)))) do
      [{_, format} | _] ->
        {:ok, format}

      [] ->
        {:error,
         Error.new(:unknown_format, "the extension of #{path} is not a known annotation format",
           fix:
             "use one of #{@endings |> Map.keys() |> Enum.sort() |> Enum.join(", ")}, or pass format:"
         )}
    end
  end

  @doc "Writes a layer to a file and returns `{:ok, losses}`."
  @spec write(Layer.t(), Path.t(), keyword()) :: {:ok, losses()} | {:error, Error.t()}
  def write(%Layer{} = layer, path, opts \\ []) do
    with {:ok, format} <- resolve_format(path, opts),
         {:ok, text, losses} <- encode(layer, format, Keyword.delete(opts, :format)) do
      case File.write(path, text) do
        :ok ->
          {:ok, losses}

        {:error, reason} ->
          {:error,
           Error.new(:not_saved, "cannot write #{path}",
             why: to_string(:file.format_error(reason))
           )}
      end
    end
  end

  defp resolve_format(path, opts),
    do: if(opts[:format], do: {:ok, opts[:format]}, else: detect_format(path))

  @doc "Encodes a layer as text and returns `{:ok, text, losses}`."
  @spec encode(Layer.t(), format(), keyword()) :: {:ok, binary(), losses()} | {:error, Error.t()}
  def encode(%Layer{} = layer, format, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options) do
      origin =
        opts[:origin] ||
          layer |> Layer.annotations() |> Enum.map(& &1.from) |> Enum.min(fn -> 0 end)

      {text, losses} =
        Map.fetch!(@formats, format).encode(layer, Keyword.put(opts, :origin, origin))

      {:ok, IO.iodata_to_binary(text), losses}
    end
  end

  @doc "Reads a file; returns `{:ok, layer, losses}`. Errors: `:not_found`, `:bad_file`, `:overlap`, schema errors."
  @spec read(Path.t(), keyword()) :: {:ok, Layer.t(), losses()} | {:error, Error.t()}
  def read(path, opts \\ []) do
    with {:ok, format} <- resolve_format(path, opts),
         {:ok, text} <- read_text(path) do
      case decode(text, format, Keyword.delete(opts, :format)) do
        {:error, %Error{code: :bad_file} = error} ->
          {:error, %{error | what: "#{path}: #{error.what}"}}

        other ->
          other
      end
    end
  end

  defp read_text(path) do
    with {:ok, %{size: size}} when size <= @largest <- File.stat(path),
         {:ok, text} <- File.read(path) do
      {:ok, text}
    else
      {:ok, %{size: size}} ->
        {:error, file_error("it has #{size} bytes; the limit is #{@largest}")}

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  @doc "Decodes the text of a file and returns `{:ok, layer, losses}`."
  @spec decode(binary(), format(), keyword()) :: {:ok, Layer.t(), losses()} | {:error, Error.t()}
  def decode(text, format, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options) do
      case Map.fetch!(@formats, format).decode(text, opts) do
        {:ok, own, annotations, losses} ->
          build_layer(opts[:schema] || own, annotations, losses, opts[:name])

        {:error, why} ->
          {:error, file_error(why)}
      end
    end
  end

  defp build_layer(nil, annotations, losses, name) do
    with {:ok, schema} <- Schema.guess_from_values(name, Enum.map(annotations, & &1.values)),
         do: build_layer(schema, annotations, losses, name)
  end

  defp build_layer(schema, annotations, losses, _name) do
    case LayerBuilder.build_layer(schema, annotations) do
      {:ok, layer, more} -> {:ok, layer, losses ++ more}
      error -> error
    end
  end

  defp file_error(why) do
    Error.new(:bad_file, "cannot read the annotation file",
      why: why,
      fix: "check the file and its format"
    )
  end
end
