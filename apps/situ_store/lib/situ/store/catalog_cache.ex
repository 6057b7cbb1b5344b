defmodule Situ.Store.CatalogCache do
  @moduledoc false
  # Caches the parsed catalog of a store until it has new records: each stream by name, all streams together, and the
  # facts about the store itself.
  alias Situ.Store.{Catalog, Folder, Native, StreamInfo}
  alias Situ.Store.S3.Mirror

  @catalog 0
  @read_bytes 4 * 1024 * 1024
  @max_time 9_223_372_036_854_775_807

  # Stream names are valid UTF-8, so these two keys cannot be names.
  @all <<0xFE>>
  @about <<0xFF>>

  @type about :: %{name: String.t(), volatile?: boolean(), piece: map() | nil, damage: term()}

  @doc "Returns the store's name, whether it is in memory, its segment facts, and any damage in its catalog."
  @spec store_info(reference(), Path.t()) :: about()
  def store_info(ref, path), do: lookup_term(ref, path, @about)

  @doc "Returns the stream of a name or `nil`, or the list of all streams for `:all`."
  @spec lookup_streams(reference(), Path.t(), String.t() | :all) ::
          StreamInfo.t() | nil | [StreamInfo.t()]
  def lookup_streams(ref, path, :all), do: lookup_term(ref, path, @all)
  def lookup_streams(ref, path, name), do: lookup_term(ref, path, name)

  defp lookup_term(ref, path, name) do
    case Native.reader_shelved(ref, name) do
      {:ok, term} ->
        :erlang.binary_to_term(term)

      nil ->
        nil

      :stale ->
        records = Native.reader_count(ref, @catalog)
        Native.reader_shelve(ref, records, build_terms(ref, path))
        lookup_term(ref, path, name)
    end
  end

  defp build_terms(ref, path) do
    {records, damage} = read_records({ref, path}, 0, [], nil)
    catalog = Catalog.parse_records(records)
    name = Folder.current_name(path, catalog.name)

    streams =
      for {_, info} <- Enum.sort(catalog.streams),
          do: %{info | store_name: name, store_path: path}

    about = %{
      name: name,
      volatile?: catalog.volatile?,
      piece: catalog.piece,
      damage: damage
    }

    # If two streams have the same name, the first one is found, as in the list.
    named = for info <- Enum.reverse(streams), do: {info.name, :erlang.term_to_binary(info)}

    named ++
      for {key, term} <- [{@all, streams}, {@about, about}],
          do: {key, :erlang.term_to_binary(term)}
  end

  # Returns the records and the reason if some of them were damaged.
  defp read_records({ref, path} = store, ordinal, parts, damage) do
    read = fn -> Native.read(ref, @catalog, ordinal, @max_time, 10_000, @read_bytes) end

    case Mirror.with_bytes(path, read) do
      {:ok, [], _} ->
        {parts |> Enum.reverse() |> Enum.concat(), damage}

      {:ok, runs, next} ->
        bytes = for {_, list} <- runs, {_, _, _, data} <- list, is_binary(data), do: data
        read_records(store, next, [bytes | parts], damage)

      # The rest of the catalog could not be fetched.
      {:error, %Situ.Error{} = error} ->
        raise error

      {:error, reason} ->
        # Records after a damaged part of the catalog are still usable.
        case Native.reader_skip(ref, @catalog, ordinal) do
          ^ordinal -> {parts |> Enum.reverse() |> Enum.concat(), reason}
          next -> read_records(store, next, parts, reason)
        end
    end
  end
end
