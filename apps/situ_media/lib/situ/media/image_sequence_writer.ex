defmodule Situ.Media.ImageSequenceWriter do
  @moduledoc """
  A sink that writes each image to a separate file, and their times to the same folder (`times.csv`).
  `Situ.Media.ImageSequence` reads them with the same originating times.

      camera |> Situ.Media.ImageSequenceWriter.write("shots/", type: :png)

  A folder that already contains such a recording is rejected, so nothing is overwritten.
  """

  alias Situ.{EncodedImage, Error, Image, ImageOps}
  alias Situ.Media.ImageSequence.Index

  @schema [
    folder: [
      type: :string,
      required: true,
      doc: "The folder to write to; created if it does not exist."
    ],
    type: [
      type: {:in, [:jpg, :png]},
      default: :jpg,
      doc: "Compression; a `Situ.EncodedImage` is written unchanged."
    ],
    quality: [type: {:integer, 1, 100}, default: 90, doc: "JPEG quality."],
    digits: [
      type: {:integer, 1, 18},
      default: 6,
      doc: "Number of digits in the file names: `000001.jpg`."
    ]
  ]

  use Situ.Component, inputs: [in: :any], options: @schema

  @doc "Connects the sink to `stream` and returns `stream`."
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
    path = Index.index_path(folder)

    with :ok <- File.mkdir_p(folder),
         # Opens exclusively, because two recordings in one folder would mix.
         {:ok, index} <- :file.open(path, [:write, :raw, :exclusive]),
         :ok <- :file.write(index, Index.header_line()) do
      {[], %{state | index: index}}
    else
      {:error, :eexist} ->
        raise Error.new(:exists, "#{folder} already contains an image sequence",
                fix: "write into another folder, or delete #{path}"
              )

      {:error, reason} ->
        raise write_error(folder, reason)
    end
  end

  @impl true
  def handle_message(:in, message, _context, %{opts: opts} = state) do
    n = state.count + 1
    {ending, bytes} = encode_image(message.data, opts)
    name = String.pad_leading(Integer.to_string(n), round(opts[:digits]), "0") <> ending
    path = Path.join(opts[:folder], name)

    # Writes the image first, so that every line of the index has a file.
    with :ok <- File.write(path, bytes, [:raw]),
         :ok <- :file.write(state.index, Index.format_line(name, message.originating_time)) do
      {[], %{state | count: n}}
    else
      {:error, reason} -> raise write_error(path, reason)
    end
  end

  @impl true
  def terminate(_reason, %{index: nil}), do: :ok
  def terminate(_reason, %{index: index}), do: :file.close(index)

  @impl true
  def describe(state), do: "#{state.count} images in #{state.opts[:folder]}"

  defp encode_image(%EncodedImage{format: :jpeg, data: bytes}, _opts), do: {".jpg", bytes}
  defp encode_image(%EncodedImage{format: :png, data: bytes}, _opts), do: {".png", bytes}

  defp encode_image(%Image{} = image, opts) do
    result =
      if opts[:type] == :png,
        do: ImageOps.encode_png(image),
        else: ImageOps.encode_jpeg(image, quality: opts[:quality])

    case result do
      {:ok, encoded} -> encode_image(encoded, opts)
      {:error, error} -> raise error
    end
  end

  defp encode_image(other, _opts) do
    raise Error.new(:wrong_data, "expected an image, got: #{inspect(other, limit: 5)}",
            fix: "connect a stream of Situ.Image or Situ.EncodedImage"
          )
  end

  defp write_error(path, reason),
    do: Error.new(:cannot_write, "cannot write #{path}: #{:file.format_error(reason)}")
end
