defmodule Situ.Bridge.Ros.Bag.Record do
  @moduledoc false
  # The records of a bag, version 2.0 (http://wiki.ros.org/Bags/Format/2.0): a header of named fields, and data. Pure.

  @ops %{2 => :message, 3 => :bag, 4 => :index, 5 => :chunk, 6 => :chunk_info, 7 => :connection}
  @codes Map.new(@ops, fn {code, op} -> {op, code} end)

  @type op :: :message | :bag | :index | :chunk | :chunk_info | :connection
  @type fields :: %{String.t() => binary()}

  @doc "The fields of a header."
  @spec fields(binary()) :: {:ok, fields()} | :error
  def fields(bytes), do: fields(bytes, %{})

  defp fields("", found), do: {:ok, found}

  defp fields(<<n::little-32, field::binary-size(n), rest::binary>>, found) do
    case :binary.split(field, "=") do
      [name, value] -> fields(rest, Map.put(found, name, value))
      _ -> :error
    end
  end

  defp fields(_, _found), do: :error

  @doc "The kind of the record with this header."
  @spec op(fields()) :: op() | nil
  def op(%{"op" => <<code>>}), do: @ops[code]
  def op(_), do: nil

  @doc "The first record in bytes: its kind, header, data, and what follows."
  @spec take(binary()) :: {:ok, op() | nil, fields(), binary(), binary()} | :error
  def take(
        <<h::little-32, header::binary-size(h), d::little-32, data::binary-size(d), rest::binary>>
      ) do
    with {:ok, fields} <- fields(header), do: {:ok, op(fields), fields, data, rest}
  end

  def take(_), do: :error

  @doc "A record as bytes."
  @spec write(op(), [{String.t(), iodata()}], iodata()) :: iodata()
  def write(op, fields, data) do
    header = header([{"op", <<@codes[op]>>} | fields])
    [<<IO.iodata_length(header)::little-32>>, header, <<IO.iodata_length(data)::little-32>>, data]
  end

  @doc "Named fields as bytes."
  @spec header([{String.t(), iodata()}]) :: iodata()
  def header(fields) do
    for {name, value} <- fields,
        do: [<<byte_size(name) + 1 + IO.iodata_length(value)::little-32>>, name, "=", value]
  end

  @doc "A field that is a number of 32 bits."
  def u32(fields, name), do: with(%{^name => <<n::little-32>>} <- fields, do: n, else: (_ -> nil))
  @doc "A field that is a number of 64 bits."
  def u64(fields, name), do: with(%{^name => <<n::little-64>>} <- fields, do: n, else: (_ -> nil))

  @doc "A time, seconds and nanoseconds, as nanoseconds."
  def time(<<seconds::little-32, ns::little-32>>), do: seconds * 1_000_000_000 + ns
  def time(_), do: nil

  @doc "Nanoseconds as a time."
  def stamp(ns), do: <<div(ns, 1_000_000_000)::little-32, rem(ns, 1_000_000_000)::little-32>>
end
