defmodule Situ.CLI.Store.Info do
  @moduledoc false
  # `situ store info`: what a person wants to know at a glance.
  alias Situ.{Store, Time}
  alias Situ.CLI.Store.Details
  alias Situ.Store.StreamInfo

  @doc "Of one recording all, of several (or the recordings in a folder) a line each."
  @spec run([Path.t()], keyword()) :: 0 | 1
  def run([path], opts) do
    if folder?(path), do: list([path], opts), else: one(path, opts)
  end

  def run(paths, opts), do: list(paths, opts)

  defp folder?(path),
    do: File.dir?(path) and not Store.exists?(path)

  # Recordings that cannot be read are told of, and are no reason to keep quiet about the others.
  defp list(paths, opts) do
    stores =
      Enum.flat_map(paths, &if(folder?(&1), do: Store.list(&1, recursive: true), else: [&1]))

    opened = for path <- stores, do: {path, Store.open(path)}

    if opts[:json] do
      IO.puts(Situ.JSON.encode(Enum.map(opened, &entry/1)))
    else
      if stores == [], do: IO.puts("No stores in #{Enum.join(paths, ", ")}.")
      Enum.each(opened, &IO.puts(short(&1)))
    end

    if Enum.all?(opened, &match?({_, {:ok, _}}, &1)), do: 0, else: 1
  end

  defp entry({_path, {:ok, store}}), do: json(store)
  defp entry({path, {:error, error}}), do: %{path: path, error: error.what}

  defp short({path, opened}) do
    case opened do
      {:ok, store} ->
        streams = Store.streams(store)

        "#{store.path}  #{number(length(streams), "stream")}, #{span(streams)}, #{Details.bytes(size(store.path))}, #{state(Store.info(store))}"

      {:error, error} ->
        "#{path}  #{error.what}"
    end
  end

  defp one(path, opts) do
    store = Store.open!(path)

    case {opts[:stream], opts[:json]} do
      {nil, true} -> IO.puts(Situ.JSON.encode(json(store)))
      {nil, _} -> text(store)
      {name, json?} -> Details.print(store, name, json? == true)
    end

    0
  end

  defp number(1, what), do: "1 #{what}"
  defp number(n, what), do: "#{n} #{what}s"

  defp text(store) do
    info = Store.info(store)
    streams = Store.streams(store)
    IO.puts("#{info.name}  (#{store.path})")

    IO.puts(
      "  #{state(info)}; #{number(length(streams), "stream")}, #{number(count(streams), "message")}, #{Details.bytes(size(store.path))} on disk"
    )

    case Store.interval(streams) do
      nil ->
        :ok

      {first, last} ->
        IO.puts(
          "  #{Time.to_iso8601(first)} .. #{Time.to_iso8601(last)}, #{Time.format_duration(last - first)}"
        )
    end

    table(store, streams)

    if info.damage != [] do
      IO.puts("  DAMAGED in #{length(info.damage)} places: `situ store verify '#{store.path}'`")
    end

    for file <- Store.missing_files(store) do
      IO.puts("  DAMAGED: #{file} is missing; `situ store verify '#{store.path}'`")
    end
  end

  defp table(_store, []), do: :ok

  defp table(store, streams) do
    head = ~w(stream type messages rate size avg latency gaps)
    rows = [head | Enum.map(streams, &row(store, &1))]

    widths =
      for column <- 0..7, do: rows |> Enum.map(&String.length(Enum.at(&1, column))) |> Enum.max()

    for row <- rows do
      cells =
        for {{cell, width}, column} <- row |> Enum.zip(widths) |> Enum.with_index() do
          if column < 2,
            do: String.pad_trailing(cell, width),
            else: String.pad_leading(cell, width)
        end

      IO.puts("  " <> String.trim_trailing(Enum.join(cells, "  ")))
    end
  end

  defp row(store, info) do
    [
      info.name <> if(info.large?, do: "*", else: ""),
      info.type_name,
      Integer.to_string(info.count),
      Details.rate(info),
      Details.bytes(info.stored),
      Details.bytes(round(StreamInfo.average_size(info) || 0)),
      Details.latency(info),
      gaps(store, info)
    ]
  end

  # A gap is ten times the usual distance, and no less than a tenth of a second.
  defp gaps(store, info) do
    case StreamInfo.rate(info) do
      nil ->
        "-"

      rate ->
        least = max(round(10.0e9 / rate), 100_000_000)

        case Store.gaps(store, info, least) do
          [] ->
            "-"

          gaps ->
            "#{length(gaps)} (#{Time.format_duration(gaps |> Enum.map(fn {a, b} -> b - a end) |> Enum.max())})"
        end
    end
  end

  defp count(streams), do: streams |> Enum.map(& &1.count) |> Enum.sum()

  defp span(streams) do
    case Store.interval(streams) do
      nil -> "empty"
      {first, last} -> Time.format_duration(last - first)
    end
  end

  defp state(%{live?: true}), do: "being written"
  defp state(%{closed?: true}), do: "closed"
  defp state(_), do: "not closed (its writer was killed; readable, `situ store repair` closes it)"

  defp size(path) do
    files = if File.dir?(path), do: Path.wildcard(Path.join(path, "*")), else: [path]
    files |> Enum.map(&File.stat!(&1).size) |> Enum.sum()
  end

  defp json(store) do
    info = Store.info(store)

    %{
      name: info.name,
      path: store.path,
      closed: info.closed?,
      live: info.live?,
      created: info.created,
      size: size(store.path),
      damage: length(info.damage),
      missing_files: Store.missing_files(store),
      streams: Enum.map(Store.streams(store), &Details.json/1)
    }
  end
end
