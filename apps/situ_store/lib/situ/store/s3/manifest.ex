defmodule Situ.Store.S3.Manifest do
  @moduledoc false
  # The object PREFIX/NAME.situ, which makes the objects PREFIX/NAME/FILE a recording. It is written last. It describes
  # the files, and contains everything that is read at opening: the whole index, checksums of all blocks, and the blocks
  # of the catalog and of the last messages.
  #
  # Its bytes are: magic (8), length of the JSON text (u32, big-endian), JSON text, and the packed contents (zlib).
  # See docs/adr/0195-a-manifest-makes-uploaded-files-a-recording.md.
  alias Situ.Error

  @magic "SITUS3M1"
  @block 65_536
  # Limits for manifests from elsewhere.
  @most_files 100_000
  @most_bytes 1_073_741_824

  @enforce_keys [:name, :id, :files]
  defstruct [:name, :id, :files, :created, :first, :last, segment?: false, bytes: 0, parts: []]

  @typedoc """
  `files` are the extents: name, size in bytes, version of the object, and CRC-32 of the checksums of its blocks.
  `parts` are the packed contents.
  """
  @type t :: %__MODULE__{
          name: String.t(),
          id: String.t(),
          files: [file()],
          created: Situ.Time.t() | nil,
          first: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          segment?: boolean(),
          bytes: non_neg_integer(),
          parts: [part()]
        }
  @type file :: %{
          name: String.t(),
          size: non_neg_integer(),
          etag: String.t() | nil,
          crc: non_neg_integer()
        }
  @typedoc "The index, the checksums of a file's blocks, or blocks of a file from a number on."
  @type part ::
          {:index, binary()}
          | {:sums, String.t(), binary()}
          | {:blocks, String.t(), non_neg_integer(), binary()}

  @doc "Returns the size of a block in bytes."
  @spec block_size() :: pos_integer()
  def block_size, do: @block

  @doc "Returns the maximum size of a manifest in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @most_bytes

  @doc "Encodes a manifest."
  @spec encode(t()) :: iodata()
  def encode(%__MODULE__{} = manifest) do
    text =
      Situ.JSON.encode(%{
        version: 1,
        name: manifest.name,
        id: manifest.id,
        created: manifest.created,
        first: manifest.first,
        last: manifest.last,
        segment: manifest.segment?,
        bytes: manifest.bytes,
        files: manifest.files,
        parts: Enum.map(manifest.parts, &describe_part/1)
      })

    packed = :zlib.compress(Enum.map(manifest.parts, &part_bytes/1))
    [@magic, <<IO.iodata_length(text)::32>>, text, packed]
  end

  defp describe_part({:index, bytes}), do: %{kind: "index", size: byte_size(bytes)}

  defp describe_part({:sums, file, bytes}),
    do: %{kind: "sums", file: file, size: byte_size(bytes)}

  defp describe_part({:blocks, file, first, bytes}),
    do: %{kind: "blocks", file: file, first: first, size: byte_size(bytes)}

  defp part_bytes(part), do: elem(part, tuple_size(part) - 1)

  @doc "Decodes a manifest. Its bytes are untrusted."
  @spec decode(binary(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def decode(<<@magic, size::32, text::binary-size(size), packed::binary>>, address) do
    with {:ok, %{"version" => 1} = value} <- Situ.JSON.decode(text),
         {:ok, manifest} <- parse_value(value),
         {:ok, bytes} <- unpack_parts(packed),
         {:ok, parts} <- split_parts(value["parts"], bytes, manifest.files, []) do
      {:ok, %{manifest | parts: parts}}
    else
      {:ok, %{"version" => version}} when is_integer(version) ->
        {:error,
         invalid_error(address, "it has version #{version}; this release knows version 1")}

      _ ->
        {:error, invalid_error(address, "its contents are malformed")}
    end
  end

  def decode(_other, address), do: {:error, invalid_error(address, "it is not a manifest")}

  defp parse_value(%{"name" => name, "id" => id, "files" => files} = value)
       when is_binary(name) and is_binary(id) and is_list(files) and length(files) <= @most_files do
    files = Enum.map(files, &parse_file/1)

    if id =~ ~r/\A[0-9a-f]{32}\z/ and :error not in files do
      {:ok,
       %__MODULE__{
         name: name,
         id: id,
         files: files,
         created: integer_or_nil(value["created"]),
         first: integer_or_nil(value["first"]),
         last: integer_or_nil(value["last"]),
         segment?: value["segment"] == true,
         bytes: integer_or_nil(value["bytes"]) || 0
       }}
    else
      :error
    end
  end

  defp parse_value(_value), do: :error

  defp parse_file(%{"name" => name, "size" => size, "crc" => crc} = file)
       when is_integer(size) and size >= 0 and size < 0x100000000000 and is_integer(crc) do
    etag = file["etag"]

    if is_binary(name) and name =~ ~r/\A(data|large)-\d{6,10}\.situ\z/ and
         (is_nil(etag) or is_binary(etag)),
       do: %{name: name, size: size, crc: crc, etag: etag},
       else: :error
  end

  defp parse_file(_file), do: :error

  defp integer_or_nil(value), do: if(is_integer(value), do: value)

  # Unpacks up to a limit, because a small object may contain very many bytes.
  defp unpack_parts(packed) do
    stream = :zlib.open()

    try do
      :zlib.inflateInit(stream)
      result = collect_unpacked(stream, :zlib.safeInflate(stream, packed), [], 0)
      # Raises an error if the bytes end too early.
      if result != :error, do: :zlib.inflateEnd(stream)
      result
    rescue
      ErlangError -> :error
    after
      :zlib.close(stream)
    end
  end

  defp collect_unpacked(stream, {state, bytes}, parts, size) do
    size = size + IO.iodata_length(bytes)

    cond do
      size > @most_bytes -> :error
      state == :finished -> {:ok, IO.iodata_to_binary([parts, bytes])}
      true -> collect_unpacked(stream, :zlib.safeInflate(stream, []), [parts, bytes], size)
    end
  end

  defp split_parts([%{"size" => size} = part | rest], bytes, files, parts)
       when is_integer(size) and size >= 0 and size <= byte_size(bytes) do
    <<mine::binary-size(size), bytes::binary>> = bytes
    file = Enum.find(files, &(&1.name == part["file"]))

    case {part, file} do
      {%{"kind" => "index"}, _} ->
        split_parts(rest, bytes, files, [{:index, mine} | parts])

      {%{"kind" => "sums"}, %{crc: crc, size: length}} ->
        # They are what all later bytes are compared with.
        if :erlang.crc32(mine) == crc and size == 4 * div(length + @block - 1, @block),
          do: split_parts(rest, bytes, files, [{:sums, file.name, mine} | parts]),
          else: :error

      {%{"kind" => "blocks", "first" => first}, %{size: length}}
      when is_integer(first) and first >= 0 and first * @block + size <= length ->
        split_parts(rest, bytes, files, [{:blocks, file.name, first, mine} | parts])

      _ ->
        :error
    end
  end

  defp split_parts([], "", files, parts) do
    sums = for {:sums, file, _} <- parts, do: file
    complete? = Enum.all?(files, &(&1.name in sums)) and List.keymember?(parts, :index, 0)
    if complete?, do: {:ok, Enum.reverse(parts)}, else: :error
  end

  defp split_parts(_parts, _bytes, _files, _found), do: :error

  defp invalid_error(address, why) do
    Error.new(:not_a_store, "#{address} is not a recording", why: why, fix: "push it again")
  end
end
