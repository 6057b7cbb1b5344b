defmodule Situ.Annotation.Exchange do
  @formats %{
    eaf: Situ.Annotation.Exchange.Elan,
    textgrid: Situ.Annotation.Exchange.TextGrid,
    webvtt: Situ.Annotation.Exchange.WebVtt,
    srt: Situ.Annotation.Exchange.Srt,
    label_studio: Situ.Annotation.Exchange.LabelStudio,
    csv: Situ.Annotation.Exchange.Csv,
    coco: Situ.Annotation.Exchange.Coco
  }
  @options [
    format: [
      type: {:in, [:eaf, :textgrid, :webvtt, :srt, :label_studio, :csv, :coco]},
      doc: "Default: by the file's ending."
    ],
    origin: [
      type: :integer,
      doc:
        "The time (ns) that the file calls zero. Default: the first begin; reading, what the file says, or 0."
    ],
    schema: [
      type: {:struct, Situ.Annotation.Schema},
      doc: "Reading: the schema to read by. Default: the file's own, or text."
    ],
    name: [
      type: :string,
      default: "Annotation",
      doc: "Reading: the name of a schema that is made up."
    ],
    media: [
      type: :string,
      doc: "Writing: the film or sound that it is about, for formats that name one."
    ],
    times: [
      type: {:list, :integer},
      doc:
        "Writing COCO: the times (ns) of the pictures that get boxes. Default: those of key frames."
    ]
  ]

  @moduledoc """
  Annotations from and for other programs.

  | format | endings | read and written by | what it does not hold |
  |---|---|---|---|
  | `:eaf` | `.eaf` | ELAN | times below 1 ms, confidence, notes, proposals |
  | `:textgrid` | `.TextGrid` | Praat | annotators, confidence, notes, proposals, empty labels |
  | `:webvtt` | `.vtt` | browsers, players | times below 1 ms, annotators and the like; points last 1 ms |
  | `:srt` | `.srt` | players | as WebVTT |
  | `:label_studio` | `.json` | Label Studio | notes |
  | `:csv` | `.csv` | spreadsheets | nothing |
  | `:coco` | `.coco.json` | trainers of detectors | whatever is no box; which boxes are key frames, with `times:` |

  `write/3` and `read/2` return a list of sentences about lost data, empty if nothing was lost.

      iex> alias Situ.Annotation.{Exchange, Layer, Schema}
      iex> hi = Situ.Annotation.new(1_000_000_000, 2_500_000_000, "P1", %{"Words" => "Hi"})
      iex> {:ok, layer} = Layer.new(Schema.text("Words"), [hi])
      iex> {:ok, text, []} = Exchange.encode(layer, :webvtt, origin: 0)
      iex> text |> String.split("\\n") |> Enum.drop(2)
      ["1", "00:00:01.000 --> 00:00:02.500", "<v P1>Hi</v>", ""]
      iex> {:ok, again, []} = Exchange.decode(text, :webvtt, schema: Schema.text("Words"))
      iex> Layer.annotations(again) == Layer.annotations(layer)
      true

  A schema with several attributes is a row per track and attribute, called `TRACK.ATTRIBUTE`, where a format's rows
  hold one text each (ELAN, Praat); reading by the same schema puts them together again.

  Files come from strangers: they are bounded (64 MB), XML with a document type is refused, nothing in them makes
  atoms.

  ## Options

  #{Situ.Options.docs(@options)}
  """
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.{Error, Options}

  @largest 64 * 1024 * 1024
  @endings %{
    ".eaf" => :eaf,
    ".textgrid" => :textgrid,
    ".vtt" => :webvtt,
    ".srt" => :srt,
    ".coco.json" => :coco,
    ".json" => :label_studio,
    ".csv" => :csv
  }

  @type format :: :eaf | :textgrid | :webvtt | :srt | :label_studio | :csv | :coco
  @type losses :: [String.t()]

  @doc "A layer as a file's text; times are relative to `origin:`. The losses name everything left out."
  @callback encode(Layer.t(), opts :: keyword()) :: {iodata(), losses()}
  @doc "The annotations of a file, its schema if it says one, or the reason in words."
  @callback decode(binary(), opts :: keyword()) ::
              {:ok, Schema.t() | nil, [Situ.Annotation.t()], losses()} | {:error, String.t()}

  @doc "The format of a file by its ending. Error: `:unknown_format`."
  @spec format(Path.t()) :: {:ok, format()} | {:error, Error.t()}
  def format(path) do
    name = path |> Path.basename() |> String.downcase()

    # The longest ending is the one that is meant.
    case @endings
         |> Enum.filter(&String.ends_with?(name, elem(&1, 0)))
         |> Enum.sort_by(&(-byte_size(elem(&1, 0)))) do
      [{_, format} | _] ->
        {:ok, format}

      [] ->
        {:error,
         Error.new(:unknown_format, "no format for annotations by the ending of #{path}",
           fix:
             "endings are #{@endings |> Map.keys() |> Enum.sort() |> Enum.join(", ")}; or give format:"
         )}
    end
  end

  @doc "Writes a layer to a file: `{:ok, losses}`."
  @spec write(Layer.t(), Path.t(), keyword()) :: {:ok, losses()} | {:error, Error.t()}
  def write(%Layer{} = layer, path, opts \\ []) do
    with {:ok, format} <- chosen(path, opts),
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

  defp chosen(path, opts), do: if(opts[:format], do: {:ok, opts[:format]}, else: format(path))

  @doc "The same as text: `{:ok, text, losses}`."
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

  @doc "Reads a file: `{:ok, layer, losses}`. Errors: `:not_found`, `:bad_file`, `:overlap` and those of the schema."
  @spec read(Path.t(), keyword()) :: {:ok, Layer.t(), losses()} | {:error, Error.t()}
  def read(path, opts \\ []) do
    with {:ok, format} <- chosen(path, opts),
         {:ok, text} <- text(path) do
      case decode(text, format, Keyword.delete(opts, :format)) do
        {:error, %Error{code: :bad_file} = error} ->
          {:error, %{error | what: "#{path}: #{error.what}"}}

        other ->
          other
      end
    end
  end

  defp text(path) do
    with {:ok, %{size: size}} when size <= @largest <- File.stat(path),
         {:ok, text} <- File.read(path) do
      {:ok, text}
    else
      {:ok, %{size: size}} ->
        {:error, bad("it has #{size} bytes, more than the #{@largest} that are read")}

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  @doc "The same out of text."
  @spec decode(binary(), format(), keyword()) :: {:ok, Layer.t(), losses()} | {:error, Error.t()}
  def decode(text, format, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options) do
      case Map.fetch!(@formats, format).decode(text, opts) do
        {:ok, own, annotations, losses} ->
          layer(opts[:schema] || own, annotations, losses, opts[:name])

        {:error, why} ->
          {:error, bad(why)}
      end
    end
  end

  defp layer(nil, annotations, losses, name) do
    with {:ok, schema} <- Schema.guess(name, Enum.map(annotations, & &1.values)),
         do: layer(schema, annotations, losses, name)
  end

  # Of two that overlap on one track (no rule of the format forbids it) the second gets a track of its own.
  defp layer(schema, annotations, losses, _name) do
    {:ok, empty} = Layer.new(schema)

    annotations
    |> Enum.sort_by(&{&1.from, &1.to})
    |> Enum.reduce_while({:ok, empty, 0}, fn annotation, {:ok, layer, moved} ->
      case place(layer, annotation, annotation.track, 1) do
        {:ok, layer, 1} -> {:cont, {:ok, layer, moved}}
        {:ok, layer, _} -> {:cont, {:ok, layer, moved + 1}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
    |> case do
      {:ok, layer, 0} ->
        {:ok, layer, losses}

      {:ok, layer, n} ->
        {:ok, layer,
         losses ++
           [
             "#{n} annotations overlap with others of their track: they are on tracks of their own"
           ]}

      error ->
        error
    end
  end

  defp place(layer, annotation, track, n) do
    name = if n == 1, do: track, else: "#{track} (#{n})"

    case Layer.add(layer, %{annotation | track: name}) do
      {:ok, layer, _} -> {:ok, layer, n}
      {:error, %{code: :overlap}} -> place(layer, annotation, track, n + 1)
      {:error, error} -> {:error, error}
    end
  end

  defp bad(why) do
    Error.new(:bad_file, "this is no file of annotations that can be read",
      why: why,
      fix: "check the file and its format"
    )
  end
end
