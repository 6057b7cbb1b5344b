defmodule Situ.Store.Test.Picture do
  @moduledoc false
  # A struct with a codec, as images have.
  @behaviour Situ.Codec
  defstruct [:width, :data]

  @impl true
  def codec_name, do: "test.picture"
  @impl true
  def encode(%{width: width, data: data}), do: [<<width::little-32>>, data]
  @impl true
  def decode(<<width::little-32, data::binary>>), do: {:ok, %__MODULE__{width: width, data: data}}
  def decode(_), do: {:error, :short}
end

defmodule Situ.Store.Test.Sound do
  @moduledoc false
  # A struct whose codec has a signal: 16 samples, 1 us apart.
  @behaviour Situ.Codec
  defstruct [:samples]

  @impl true
  def codec_name, do: "test.sound"
  @impl true
  def encode(%{samples: samples}), do: for(s <- samples, do: <<s::little-signed-16>>)
  @impl true
  def decode(bytes), do: {:ok, %__MODULE__{samples: for(<<s::little-signed-16 <- bytes>>, do: s)}}
  @impl true
  def points(%{samples: samples}, time) do
    for {s, i} <- Enum.with_index(samples), do: {time + i * 1_000, s, s, s, 1}
  end
end

defmodule Situ.Store.Test.Person do
  @moduledoc false
  defstruct name: "", age: 0
end

defmodule Situ.Store.Test.Record do
  @moduledoc false
  alias Situ.Message
  alias Situ.Store.Writer

  def message(data, time, creation \\ nil, sequence \\ 1) do
    %Message{
      data: data,
      originating_time: time,
      creation_time: creation || time + 5,
      sequence_id: sequence
    }
  end

  def messages(values, step \\ 1_000) do
    for {value, i} <- Enum.with_index(values), do: message(value, i * step, i * step + 5, i + 1)
  end

  @doc "Writes a closed store with the streams `[{name, messages, options}]` and returns its path."
  def store(root, streams, name \\ "test") do
    {:ok, writer} = Writer.create(name, root)

    for {name, messages, options} <- streams do
      {:ok, stream} = Writer.stream(writer, name, options)

      stream =
        messages
        |> Enum.chunk_every(100)
        |> Enum.reduce(stream, fn batch, stream ->
          {:ok, stream} = Writer.append(stream, batch)
          stream
        end)

      last = if messages == [], do: 0, else: List.last(messages).originating_time
      {:ok, _} = Writer.close_stream(stream, last)
    end

    :ok = Writer.close(writer)
    writer.path
  end
end

defmodule Situ.Store.Test.Raw do
  @moduledoc false
  # Stores a hand-written term: replaces a stored term of the same length in the file and corrects the checksums.
  alias Situ.Store
  import Situ.Store.Test.Record

  def decode(root, term) do
    {:ok, [message]} = root |> written(term) |> Store.open!() |> Store.read("T")
    message.data
  end

  @doc "Returns the path of a store whose stream `T` contains a message with this external term."
  def written(root, term) do
    # The placeholder's external term has the same number of bytes.
    placeholder = [String.duplicate("p", byte_size(term) - 12)]
    ^term = <<term::binary>>
    external = :erlang.term_to_binary(placeholder)
    true = byte_size(external) == byte_size(term)
    replace(store(root, [{"T", messages([placeholder]), []}], "raw"), external, term)
  end

  @doc "Replaces bytes in a store's data with the same number of bytes and corrects the checksums."
  def replace(path, old, new) when byte_size(old) == byte_size(new) do
    file = Path.join(path, "data-000000.situ")
    bytes = File.read!(file)
    {at, length} = :binary.match(bytes, old)
    behind = at + length
    before = binary_part(bytes, 0, at)
    rest = binary_part(bytes, behind, byte_size(bytes) - behind)
    File.write!(file, [before, new, rest])
    {:ok, %{damage: [_]}} = Store.verify(path)
    File.write!(file, fix(before <> new <> rest, at))
    path
  end

  # The chunk header precedes the payload; its body checksum is at 92 and its own checksum at 4.
  defp fix(bytes, payload) do
    start =
      bytes
      |> :binary.matches("CHK2")
      |> Enum.map(&elem(&1, 0))
      |> Enum.filter(&(&1 < payload))
      |> Enum.max()

    <<length::little-32>> = binary_part(bytes, start + 8, 4)
    <<table::little-32>> = binary_part(bytes, start + 84, 4)

    bytes =
      put(bytes, start + 92, crc(binary_part(bytes, start + 112 + table, length - 112 - table)))

    put(bytes, start + 4, crc(binary_part(bytes, start + 8, 104 + table)))
  end

  defp put(bytes, at, value) do
    behind = binary_part(bytes, at + 4, byte_size(bytes) - at - 4)
    binary_part(bytes, 0, at) <> <<value::little-32>> <> behind
  end

  defp crc(bytes) do
    import Bitwise

    crc =
      for <<byte <- bytes>>, reduce: 0xFFFFFFFF do
        crc ->
          Enum.reduce(1..8, bxor(crc, byte), fn _, c ->
            if (c &&& 1) == 1, do: bxor(c >>> 1, 0x82F63B78), else: c >>> 1
          end)
      end

    bxor(crc, 0xFFFFFFFF)
  end
end
