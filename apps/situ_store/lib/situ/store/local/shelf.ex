defmodule Situ.Store.Local.Shelf do
  @moduledoc false
  # The catalog of a store, worked out once for as long as it has no more records: every stream by its name, all of
  # them, and what is said of the store itself.
  alias Situ.Store.{Catalog, Folder, Native, StreamInfo}

  @catalog 0
  @read_bytes 4 * 1024 * 1024
  @max_time 9_223_372_036_854_775_807

  # Names are text, so these two are none.
  @all <<0xFE>>
  @about <<0xFF>>

  @type about :: %{name: String.t(), volatile?: boolean(), piece: map() | nil, damage: term()}

  @doc "The store's name, whether it is one in memory, and what was wrong with its catalog."
  @spec about(reference(), Path.t()) :: about()
  def about(ref, path), do: shelved(ref, path, @about)

  @doc "The stream of a name, or `nil`; of `:all` a list."
  @spec fetch(reference(), Path.t(), String.t() | :all) :: StreamInfo.t() | nil | [StreamInfo.t()]
  def fetch(ref, path, :all), do: shelved(ref, path, @all)
  def fetch(ref, path, name), do: shelved(ref, path, name)

  defp shelved(ref, path, name) do
    case Native.reader_shelved(ref, name) do
      {:ok, term} ->
        :erlang.binary_to_term(term)

      nil ->
        nil

      :stale ->
        records = Native.reader_count(ref, @catalog)
        Native.reader_shelve(ref, records, terms(ref, path))
        shelved(ref, path, name)
    end
  end

  defp terms(ref, path) do
    {records, damage} = records(ref, 0, [], nil)
    catalog = Catalog.parse(records)
    name = Folder.own_name(path, catalog.name)

    streams =
      for {_, info} <- Enum.sort(catalog.streams),
          do: %{info | store_name: name, store_path: path}

    about = %{
      name: name,
      volatile?: catalog.volatile?,
      piece: catalog.piece,
      damage: damage
    }

    # Of two of one name the first is found by it, as in the list.
    named = for info <- Enum.reverse(streams), do: {info.name, :erlang.term_to_binary(info)}

    named ++
      for {key, term} <- [{@all, streams}, {@about, about}],
          do: {key, :erlang.term_to_binary(term)}
  end

  # The records, and what was wrong with some of them.
  defp records(ref, ordinal, parts, damage) do
    case Native.read(ref, @catalog, ordinal, @max_time, 10_000, @read_bytes) do
      {:ok, [], _} ->
        {parts |> Enum.reverse() |> Enum.concat(), damage}

      {:ok, runs, next} ->
        bytes = for {_, list} <- runs, {_, _, _, data} <- list, is_binary(data), do: data
        records(ref, next, [bytes | parts], damage)

      {:error, reason} ->
        # A damaged part of the catalog: what follows it is still good.
        case Native.reader_skip(ref, @catalog, ordinal) do
          ^ordinal -> {parts |> Enum.reverse() |> Enum.concat(), reason}
          next -> records(ref, next, parts, reason)
        end
    end
  end
end
