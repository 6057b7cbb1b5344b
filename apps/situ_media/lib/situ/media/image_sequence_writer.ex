defmodule Situ.Media.ImageSequenceWriter do
  alias Situ.{EncodedImage, Error, Image, Imaging}
  alias Situ.Media.ImageSequence.Index

  @schema [
    folder: [type: :string, required: true, doc: "Where to; it is made when it is not there."],
    type: [
      type: {:in, [:jpg, :png]},
      default: :jpg,
      doc: "How to compress; `Situ.EncodedImage`s are written as they are."
    ],
    quality: [type: {:integer, 1, 100}, default: 90, doc: "Quality of JPEG."],
    digits: [type: {:integer, 1, 18}, default: 6, doc: "Digits in the names: `000001.jpg`."]
  ]

  @moduledoc """
  A sink that writes every picture into a file of its own, and their times beside them (`times.csv`), so that
  `Situ.Media.ImageSequence` reads them back with the same originating times.

      camera |> Situ.Media.ImageSequenceWriter.write("shots/", type: :png)

  A folder that holds such a recording already is refused: nothing is overwritten.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, inputs: [in: :any], options: @schema

  @doc "Connects the sink to `stream`; returns `stream`, so that it can be used further."
  @spec write(Situ.Stream.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def write(stream, folder, opts \\ []) do
    Situ.via(stream, __MODULE__, [folder: folder] ++ opts)
    stream
  end

  @impl true
  def init(opts), do: {:ok, %{opts: opts, index: nil, count: 0}}

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    folder = opts[:folder]
    path = Index.path(folder)

    with :ok <- File.mkdir_p(folder),
         # Exclusive: two recordings in one folder would mix.
         {:ok, index} <- :file.open(path, [:write, :raw, :exclusive]),
         :ok <- :file.write(index, Index.header()) do
      {[], %{state | index: index}}
    else
      {:error, :eexist} ->
        raise Error.new(:exists, "#{folder} holds a sequence of pictures already",
                fix: "write into another folder, or delete #{path}"
              )

      {:error, reason} ->
        raise failed(folder, reason)
    end
  end

  @impl true
  def handle_message(:in, message, _context, %{opts: opts} = state) do
    n = state.count + 1
    {ending, bytes} = encode(message.data, opts)
    name = String.pad_leading(Integer.to_string(n), round(opts[:digits]), "0") <> ending
    path = Path.join(opts[:folder], name)

    # The picture first: a line of the index always has its file.
    with :ok <- File.write(path, bytes, [:raw]),
         :ok <- :file.write(state.index, Index.line(name, message.originating_time)) do
      {[], %{state | count: n}}
    else
      {:error, reason} -> raise failed(path, reason)
    end
  end

  @impl true
  def terminate(_reason, %{index: nil}), do: :ok
  def terminate(_reason, %{index: index}), do: :file.close(index)

  @impl true
  def describe(state), do: "#{state.count} pictures in #{state.opts[:folder]}"

  defp encode(%EncodedImage{format: :jpeg, data: bytes}, _opts), do: {".jpg", bytes}
  defp encode(%EncodedImage{format: :png, data: bytes}, _opts), do: {".png", bytes}

  defp encode(%Image{} = image, opts) do
    result =
      if opts[:type] == :png,
        do: Imaging.encode_png(image),
        else: Imaging.encode_jpeg(image, quality: opts[:quality])

    case result do
      {:ok, encoded} -> encode(encoded, opts)
      {:error, error} -> raise error
    end
  end

  defp encode(other, _opts) do
    raise Error.new(:wrong_data, "not a picture: #{inspect(other, limit: 5)}",
            fix: "connect a stream of Situ.Image or Situ.EncodedImage"
          )
  end

  defp failed(path, reason),
    do: Error.new(:cannot_write, "cannot write #{path}: #{:file.format_error(reason)}")
end
