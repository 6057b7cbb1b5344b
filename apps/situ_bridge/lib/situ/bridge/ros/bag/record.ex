defmodule Situ.Bridge.Ros.Bag.Record do
  @moduledoc false
  # Parses and encodes the records of a bag, version 2.0 (http://wiki.ros.org/Bags/Format/2.0). A record has a header
  # with named fields, and data. Pure.

  @ops %{2 => :message, 3 => :bag, 4 => :index, 5 => :chunk, 6 => :chunk_info, 7 => :connection}
  @codes Map.new(@ops, fn {code, op} -> {op, code} end)

  @type op :: :message | :bag | :index | :chunk | :chunk_info | :connection
  @type fields :: %{String.t() => binary()}

  @doc "Parses the fields of a header."
  @spec parse_fields(binary()) :: {:ok, fields()} | :error
  def parse_fields(bytes), do: collect_fields(bytes, %{})

  defp collect_fields("", fields), do: {:ok, fields}

  defp collect_fields(<<n::little-32, field::binary-size(n), rest::binary>>, fields) do
    case :binary.split(field, "=") do
      [name, value] -> collect_fields(rest, Map.put(fields, name, value))
      _ -> :error
    end
  end

  defp collect_fields(_, _fields), do: :error

  @doc "Returns the kind of the record with these header fields, or nil if the kind is unknown."
  @spec record_kind(fields()) :: op() | nil
  def record_kind(%{"op" => <<code>>}), do: @ops[code]
  def record_kind(_), do: nil

  @doc "Takes the first record off `bytes`. Returns its kind, header fields and data, and the remaining bytes."
  @spec take_record(binary()) :: {:ok, op() | nil, fields(), binary(), binary()} | :error
  def take_record(
        <<h::little-32, header::binary-size(h), d::little-32, data::binary-size(d), rest::binary>>
      ) do
    with {:ok, fields} <- parse_fields(header), do: {:ok, record_kind(fields), fields, data, rest}
  end

  def take_record(_), do: :error

  @doc "Encodes a record."
  @spec encode_record(op(), [{String.t(), iodata()}], iodata()) :: iodata()
  def encode_record(op, fields, data) do
    header = encode_fields([{"op", <<@codes[op]>>} | fields])
    [<<IO.iodata_length(header)::little-32>>, header, <<IO.iodata_length(data)::little-32>>, data]
  end

  @doc "Encodes named fields."
  @spec encode_fields([{String.t(), iodata()}]) :: iodata()
  def encode_fields(fields) do
    for {name, value} <- fields,
        do: [<<byte_size(name) + 1 + IO.iodata_length(value)::little-32>>, name, "=", value]
  end

  @doc "Returns the value of a 32-bit field, or nil."
  def get_u32(fields, name),
    do: with(%{^name => <<n::little-32>>} <- fields, do: n, else: (_ -> nil))

  @doc "Returns the value of a 64-bit field, or nil."
  def get_u64(fields, name),
    do: with(%{^name => <<n::little-64>>} <- fields, do: n, else: (_ -> nil))

  @doc "Converts a time in seconds and nanoseconds to nanoseconds."
  def parse_time(<<seconds::little-32, ns::little-32>>), do: seconds * 1_000_000_000 + ns
  def parse_time(_), do: nil

  @doc "Encodes a time in nanoseconds as seconds and nanoseconds."
  def encode_time(ns),
    do: <<div(ns, 1_000_000_000)::little-32, rem(ns, 1_000_000_000)::little-32>>
end
