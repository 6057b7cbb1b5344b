defmodule Situ.Bridge.Psi.Catalog do
  @moduledoc false
  # The catalog lists the streams and types of a store. It is append-only, so the last entry of a stream is the valid
  # one.
  import Bitwise
  alias Situ.Bridge.Psi.{Blocks, Bytes, Schema}

  defstruct streams: %{}, schemas: %{}, runtime: nil

  defmodule Entry do
    @moduledoc false
    # One stream in the catalog. `count`, `size` and the times are not valid until the stream is closed.
    @enforce_keys [:name, :id, :type_name, :flags]
    defstruct [
      :name,
      :id,
      :type_name,
      :flags,
      :opened,
      :closed,
      :supplemental_type,
      :supplemental,
      count: 0,
      size: 0,
      latency_ticks: 0,
      runtime_types: %{}
    ]

    @type t :: %__MODULE__{}

    @doc "Returns whether the messages of the stream are in the files for large messages."
    def indexed?(%{flags: flags}), do: (flags &&& 4) != 0
    def closed?(%{flags: flags}), do: (flags &&& 2) != 0
  end

  @type t :: %__MODULE__{}

  # An entry has a name, a few numbers and perhaps a schema. A megabyte is a hundred times the largest entry seen.
  @max_entry 1_048_576

  @doc "Reads the catalog of a store. Returns it with sentences that describe the damage found."
  @spec read(Path.t(), String.t()) :: {t(), [String.t()]}
  def read(folder, name) do
    Blocks.reduce(
      {folder, name, :catalog},
      @max_entry,
      %__MODULE__{},
      &add_entry(&2, elem(&1, 3))
    )
  end

  @doc "Returns the names of the types that streams used in addition to their declared types, by type number."
  @spec runtime_types(t()) :: %{integer() => String.t()}
  def runtime_types(catalog),
    do:
      Enum.reduce(catalog.streams, %{}, fn {_, entry}, types ->
        Map.merge(types, entry.runtime_types)
      end)

  @doc "Adds an entry to the catalog. Invalid entries are ignored."
  @spec add_entry(t(), binary()) :: t()
  def add_entry(catalog, bytes) do
    with {:ok, header, rest} <- parse_header(bytes) do
      put_entry(header.kind, header, rest, catalog)
    else
      :error -> catalog
    end
  end

  defp parse_header(bytes) do
    with {:ok, name, <<id::little-signed-32, rest::binary>>} <- Bytes.parse_string(bytes),
         {:ok, type, <<version::little-signed-32, rest::binary>>} <- Bytes.parse_string(rest),
         {:ok, serializer, rest} <- Bytes.parse_string(rest),
         <<system::little-signed-32, flags::little-16, kind::little-16, rest::binary>> <- rest do
      header = %{name: name || "", id: id, type_name: type || "", version: version}

      {:ok,
       Map.merge(header, %{serializer: serializer || "", system: system, flags: flags, kind: kind}),
       rest}
    else
      _ -> :error
    end
  end

  defp put_entry(0, header, rest, catalog) do
    case parse_stream(header, rest) do
      {:ok, entry} -> put_in(catalog.streams[header.id], entry)
      :error -> catalog
    end
  end

  defp put_entry(1, header, _rest, catalog), do: %{catalog | runtime: header.name}

  defp put_entry(2, header, rest, catalog) do
    case Schema.parse(header, rest) do
      {:ok, schema} -> put_in(catalog.schemas[header.name], schema)
      :error -> catalog
    end
  end

  defp put_entry(_kind, _header, _rest, catalog), do: catalog

  defp parse_stream(header, <<opened::little-64, closed::little-64, rest::binary>>) do
    entry = %Entry{
      name: header.name,
      id: header.id,
      type_name: header.type_name,
      flags: header.flags,
      opened: Bytes.parse_optional_time(opened),
      closed: Bytes.parse_optional_time(closed)
    }

    with {:ok, entry, rest} <- parse_statistics(header.version, entry, rest),
         {:ok, entry, rest} <- runtime_types(entry, rest),
         do: {:ok, parse_supplemental(header.version, entry, rest)}
  end

  defp parse_stream(_header, _rest), do: :error

  defp parse_statistics(version, entry, rest) when version >= 2 do
    case rest do
      <<count::little-signed-64, size::little-signed-64, latency::little-signed-64,
        _times::binary-32, rest::binary>> ->
        {:ok, %{entry | count: count, size: size, latency_ticks: latency}, rest}

      _ ->
        :error
    end
  end

  # Before version 2, the catalog stored averages (of bytes and microseconds) instead of sums.
  defp parse_statistics(
         _old,
         entry,
         <<count::little-signed-32, _times::binary-32, size::little-signed-32,
           latency::little-signed-32, rest::binary>>
       ) do
    {:ok, %{entry | count: count, size: count * size, latency_ticks: count * latency * 10}, rest}
  end

  defp parse_statistics(_old, _entry, _rest), do: :error

  defp runtime_types(%{flags: flags} = entry, <<n::little-signed-32, rest::binary>>)
       when (flags &&& 8) != 0 and n >= 0 do
    runtime_types(entry, n, rest)
  end

  defp runtime_types(%{flags: flags}, _rest) when (flags &&& 8) != 0, do: :error
  defp runtime_types(entry, rest), do: {:ok, entry, rest}

  defp runtime_types(entry, 0, rest), do: {:ok, entry, rest}

  defp runtime_types(entry, n, <<id::little-signed-32, rest::binary>>) do
    with {:ok, name, rest} <- Bytes.parse_string(rest),
         do: runtime_types(put_in(entry.runtime_types[id], name), n - 1, rest)
  end

  defp runtime_types(_entry, _n, _rest), do: :error

  defp parse_supplemental(0, entry, _rest), do: entry

  defp parse_supplemental(_version, entry, rest) do
    with {:ok, type, <<n::little-signed-32, bytes::binary-size(n), _::binary>>}
         when type != nil and n >= 0 <-
           Bytes.parse_string(rest) do
      %{entry | supplemental_type: type, supplemental: :binary.copy(bytes)}
    else
      _ -> entry
    end
  end
end
