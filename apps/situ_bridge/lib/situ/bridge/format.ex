defmodule Situ.Bridge.Format do
  @moduledoc """
  Encodes messages as bytes that other programs read: one at a time for a transport, or many in a file.

  | name | one message | a file |
  |---|---|---|
  | `:json` | `{"originatingTime":"2020-01-31T12:34:56.1234567Z","message":...}` | an array of them |
  | `:json_lines` | the same | one per line |
  | `:csv` | a heading and a record, each ending in `\\r\\n`; the columns are `_OriginatingTime_` and `_Value_`, `_Column0_` ... or the fields | one heading, then records |
  | `:message_pack` | a map of `message` and `originatingTime` (ticks of 100 ns since the year 1) | frames: a 32-bit length (little-endian) and a message; a length of 0 at the end |
  | `:situ` | any value in the format of stores, including images, audio and arrays: the time, a codec's name, bytes | frames as above |

  All layouts except `:situ` are compatible with \\psi, so that both can read each other's files and sockets. Situ
  avoids \\psi's quirks: integers may have any size, times are always UTC, strings that look like dates stay strings,
  an empty stream is a complete file, and nanoseconds that are not a multiple of 100 are preserved.

      iex> alias Situ.Bridge.Format
      iex> {:ok, bytes} = Format.encode(:json, %{x: 1.5}, 0)
      {:ok, ~s({"originatingTime":"1970-01-01T00:00:00.0000000Z","message":{"x":1.5}})}
      iex> Format.decode(:json, bytes)
      {:ok, {0, %{"x" => 1.5}}}

  A CSV file has one heading, made from its first message. Members that a later message lacks become empty fields;
  members that the heading lacks are an error. Lists within an object have no columns. `situ store save` writes them,
  because it reads all messages before it writes the heading.

  JSON and CSV contain bytes that are not text, such as JPEG data, as base64.

  Values are numbers, strings, booleans, `nil`, `:nan`, `:infinity`, `:neg_infinity`, lists, maps, structs (as maps of
  their fields) and `{[{key, value}]}`, an object with ordered members. Reading returns maps with string keys and
  creates no atoms; with `objects: :pairs` objects are returned as ordered pairs.
  """
  alias Situ.Bridge.Format.{Csv, Json, JsonLines, MessagePack, StoreFormat}
  alias Situ.Error
  alias Situ.Columns

  @type name :: :json | :json_lines | :csv | :message_pack | :situ
  @type timed :: {Situ.Time.t(), value :: term()}
  @typedoc "The bytes that are not read yet, and the format's state for a file."
  @type rest :: {binary(), state :: term()}

  @doc "Encodes a single message."
  @callback encode(value :: term(), Situ.Time.t()) :: iodata()
  @doc "Decodes a single message."
  @callback decode(binary(), opts :: keyword()) :: {:ok, timed()} | {:error, String.t()}
  @typedoc "A position in a file: the number of records before it, and the columns of its heading. 0 is the start."
  @type position :: non_neg_integer() | {pos_integer(), [String.t()]}

  @doc "Encodes a record of a file."
  @callback record(value :: term(), Situ.Time.t(), position()) :: iodata()
  @doc "Returns the position after the first record of a file. Only formats with a heading implement it."
  @callback first_position(value :: term()) :: position()
  @doc "Encodes the records of plain numbers; for formats that can encode many of them faster in one call."
  @callback columns(Situ.Columns.t(), position()) :: iodata()
  @doc "Returns the end of a file."
  @callback finish(position()) :: iodata()
  @doc "Returns the state before the first byte of a file."
  @callback start() :: term()
  @doc """
  Splits `bytes` into complete records and the rest, which is passed to the next call. If `last?` is true, the file
  ends with these bytes.
  """
  @callback split(bytes :: binary(), state :: term(), last? :: boolean(), opts :: keyword()) ::
              {:ok, [timed()], rest()} | {:error, String.t()}

  @optional_callbacks columns: 2, first_position: 1

  @modules %{
    json: Json,
    json_lines: JsonLines,
    csv: Csv,
    message_pack: MessagePack,
    situ: StoreFormat
  }

  @doc "Returns the names of all formats."
  @spec format_names() :: [name()]
  def format_names, do: Map.keys(@modules)

  @doc "Returns the format's module; raises `ArgumentError` for an unknown name."
  @spec fetch_module!(name()) :: module()
  def fetch_module!(name) do
    Map.get(@modules, name) ||
      raise ArgumentError,
            "unknown format #{inspect(name)}; the formats are #{inspect(format_names())}"
  end

  @doc "Encodes one message. Error: `:not_writable` if the format cannot represent the value."
  @spec encode(name(), value :: term(), Situ.Time.t()) :: {:ok, binary()} | {:error, Error.t()}
  def encode(name, value, time) do
    {:ok, name |> fetch_module!() |> apply(:encode, [value, time]) |> IO.iodata_to_binary()}
  catch
    {:not_writable, what} -> {:error, not_writable_error(name, what)}
  end

  @doc """
  Encodes a part of a stream (`Situ.Store.columns/3`) at a position of a file; returns the records and the position
  after them. Raises `Situ.Error` (`:not_writable`) if the format cannot represent a value or the heading has no
  column for it.
  """
  @spec encode_records(name(), Columns.t() | [Situ.Message.t()], position()) ::
          {iodata(), position()}
  def encode_records(name, part, position) do
    module = fetch_module!(name)

    case part do
      %Columns{} ->
        if function_exported?(module, :columns, 2) and plain_numbers?(position),
          do:
            {apply(module, :columns, [part, position]),
             next_position(module, 0, position, part.count)},
          else: part |> Columns.to_pairs() |> encode_pairs(module, position)

      messages ->
        messages |> Enum.map(&{&1.originating_time, &1.data}) |> encode_pairs(module, position)
    end
  catch
    {:not_writable, what} -> raise not_writable_error(name, what)
  end

  defp plain_numbers?({_, names}), do: names == ["_Value_"]
  defp plain_numbers?(_n), do: true

  defp encode_pairs(pairs, module, position),
    do:
      Enum.map_reduce(pairs, position, fn {time, value}, position ->
        encode_record(module, value, time, position)
      end)

  @doc false
  @spec encode_record(module(), term(), Situ.Time.t(), position()) :: {iodata(), position()}
  def encode_record(module, value, time, position),
    do: {module.record(value, time, position), next_position(module, value, position, 1)}

  defp next_position(_module, _value, {n, names}, count), do: {n + count, names}

  defp next_position(module, value, 0, count) do
    if function_exported?(module, :first_position, 1),
      do: next_position(module, value, module.first_position(value), count - 1),
      else: count
  end

  defp next_position(_module, _value, n, count), do: n + count

  @doc "Returns the number of records before a position."
  @spec record_count(position()) :: non_neg_integer()
  def record_count({n, _names}), do: n
  def record_count(n), do: n

  @doc "Decodes one message into its time and value. Option: `objects: :maps | :pairs`. Error: `:bad_message`."
  @spec decode(name(), binary(), keyword()) :: {:ok, timed()} | {:error, Error.t()}
  def decode(name, bytes, opts \\ []) do
    with {:error, why} <- fetch_module!(name).decode(bytes, opts) do
      {:error,
       Error.new(:bad_message, "#{byte_size(bytes)} bytes are not a #{name} message",
         why: why,
         fix: "check that the sender and the receiver use the same format"
       )}
    end
  end

  @doc false
  def not_writable_error(name, {:no_column, column, value}) do
    Error.new(:not_writable, "#{inspect(value, limit: 5)} cannot be written as #{name}",
      why: "the heading, made from the first message, has no column #{inspect(column)}",
      fix: "write JSON lines or Parquet, or map the stream to messages that have all members"
    )
  end

  def not_writable_error(name, what) do
    Error.new(:not_writable, "#{inspect(what, limit: 5)} cannot be written as #{name}",
      fix: "map the stream to numbers, strings, lists and maps before it is written"
    )
  end
end
