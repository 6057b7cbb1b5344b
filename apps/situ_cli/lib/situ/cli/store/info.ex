defmodule Situ.CLI.Store.Info do
  @moduledoc false
  # `situ store info`: what a person wants to know at a glance.
  alias Situ.{Store, Time}
  alias Situ.Store.StreamInfo

  @spec run(Path.t(), keyword()) :: 0 | 1
  def run(path, opts) do
    cond do
      Store.exists?(path) or File.regular?(path) -> one(path, opts)
      File.dir?(path) -> folder(path, opts)
      true -> one(path, opts)
    end
  end

  defp folder(path, opts) do
    stores = Store.list(path, recursive: true)

    if opts[:json] do
      IO.puts(Situ.JSON.encode(Enum.map(stores, &json/1)))
    else
      if stores == [], do: IO.puts("No stores in #{path}.")
      Enum.each(stores, &IO.puts(short(&1)))
    end

    0
  end

  defp short(path) do
    case Store.open(path) do
      {:ok, store} ->
        streams = Store.streams(store)

        "#{path}  #{length(streams)} streams, #{span(streams)}, #{bytes(size(store.path))}, #{state(Store.info(store))}"

      {:error, error} ->
        "#{path}  #{error.what}"
    end
  end

  defp one(path, opts) do
    if opts[:json],
      do: IO.puts(Situ.JSON.encode(json(path))),
      else: text(Store.open!(path))

    0
  end

  defp text(store) do
    info = Store.info(store)
    streams = Store.streams(store)
    IO.puts("#{info.name}  (#{store.path})")

    IO.puts(
      "  #{state(info)}; #{length(streams)} streams, #{count(streams)} messages, #{bytes(size(store.path))} on disk"
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
      IO.puts("  DAMAGED in #{length(info.damage)} places: `situ store verify #{store.path}`")
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
      rate(StreamInfo.rate(info)),
      bytes(info.stored),
      bytes(round(StreamInfo.average_size(info) || 0)),
      latency(StreamInfo.average_latency(info)),
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

  defp latency(nil), do: "-"
  defp latency(ns), do: Time.format_duration(round(ns))

  defp rate(nil), do: "-"
  defp rate(hz) when hz >= 1_000, do: "#{Float.round(hz / 1_000, 2)} kHz"
  defp rate(hz), do: "#{Float.round(hz, 2)} Hz"

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

  defp bytes(n) when n >= 1_000_000_000, do: "#{Float.round(n / 1.0e9, 2)} GB"
  defp bytes(n) when n >= 1_000_000, do: "#{Float.round(n / 1.0e6, 2)} MB"
  defp bytes(n) when n >= 1_000, do: "#{Float.round(n / 1.0e3, 1)} kB"
  defp bytes(n), do: "#{n} B"

  defp json(path) do
    store = Store.open!(path)
    info = Store.info(store)
    streams = Store.streams(store)

    %{
      name: info.name,
      path: store.path,
      closed: info.closed?,
      live: info.live?,
      created: info.created,
      size: size(store.path),
      damage: length(info.damage),
      streams: Enum.map(streams, &stream/1)
    }
  end

  defp stream(info) do
    info
    |> Map.take([:id, :name, :count, :size, :stored, :first, :last, :first_creation])
    |> Map.merge(%{
      last_creation: info.last_creation,
      type: info.type_name,
      opened: info.opened,
      closed: info.closed,
      large: info.large?,
      compression: info.compression,
      latency_sum: info.latency_sum,
      rate: StreamInfo.rate(info),
      average_size: StreamInfo.average_size(info),
      average_latency: StreamInfo.average_latency(info)
    })
  end
end
