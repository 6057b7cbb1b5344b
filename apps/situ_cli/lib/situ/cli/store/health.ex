defmodule Situ.CLI.Store.Health do
  @moduledoc false
  # Implements `situ store verify` and `situ store repair`.
  alias Situ.CLI.{Output, Progress}
  alias Situ.CLI.Store.{Foreign, Saving}
  alias Situ.{Error, Store}

  @spec verify([Path.t()], keyword()) :: 0 | 1
  def verify(paths, opts) do
    reports = for path <- paths, do: {path, checked(path, opts, length(paths))}
    if opts[:json], do: json(reports)
    if Enum.all?(reports, &match?({_, {:ok, %{damage: []}}}, &1)), do: 0, else: 1
  end

  # A path that is not a store must not prevent the others from being checked.
  defp checked(path, opts, n) do
    result =
      Progress.show("verify", opts, fn progress ->
        if File.regular?(path),
          do: Foreign.verify(path, progress),
          else: Store.verify(path, progress: progress)
      end)

    if n == 1, do: ok!(result)
    if not (opts[:json] || false), do: text(if(n > 1, do: path <> ": ", else: ""), path, result)
    result
  end

  defp text(prefix, _path, {:ok, %{chunks: chunks, damage: []}}),
    do: Output.puts("#{prefix}#{chunks} chunks, all intact")

  defp text(prefix, _path, {:ok, %{messages: messages, damage: []}}),
    do: Output.puts("#{prefix}#{messages} messages, all readable")

  defp text(prefix, path, {:ok, %{messages: _, damage: damage}}) do
    Output.puts(prefix <> "DAMAGED")
    for %{why: why} <- damage, do: Output.puts("  " <> why)
    Output.puts(foreign_error(path, nil).fix)
  end

  defp text(prefix, path, {:ok, %{damage: damage}}) do
    Output.puts(prefix <> "DAMAGED")
    places(damage)
    Output.puts("`situ store repair '#{path}'` keeps the intact data.")
  end

  defp text(prefix, _path, {:error, error}), do: Output.puts(prefix <> error.what)

  # For repeated damage in one file, prints only the first position and the number of others.
  defp places(damage) do
    for [first | more] <- Enum.chunk_by(damage, &{&1.file, &1.why}) do
      also = if more == [], do: "", else: " (and at #{length(more)} more positions)"
      Output.puts("  #{first.file} at byte #{first.offset}: #{first.why}#{also}")
    end
  end

  defp json([{_, {:ok, report}}]), do: Output.json(report)

  defp json(reports) do
    all =
      for {path, result} <- reports do
        case result do
          {:ok, report} -> Map.put(report, :path, path)
          {:error, error} -> %{path: path, error: error.what}
        end
      end

    Output.json(all)
  end

  @spec repair(Path.t(), Path.t() | nil, keyword()) :: 0
  def repair(path, out, opts) do
    cond do
      File.regular?(path) and mcap?(path) and out != nil and mcap?(out) ->
        recover(path, out, opts)

      File.regular?(path) ->
        raise foreign_error(path, out)

      out != nil ->
        raise in_place_error(path)

      true ->
        repair(path, opts)
    end
  end

  defp mcap?(path), do: Saving.format(path) == :mcap

  defp foreign_error(path, out) do
    fix =
      cond do
        not mcap?(path) ->
          "run `situ store import --skip-damage '#{path}' NAME` to save the readable data in a store"

        out == nil ->
          "run `situ store recover '#{path}' '#{Path.rootname(path)}-recovered.mcap'` to save the readable data"

        true ->
          "name a new file that ends in .mcap, or create a store: `situ store import --skip-damage '#{path}' NAME`"
      end

    Error.new(:not_a_store, "#{path} is an external file, which is never changed", fix: fix)
  end

  defp in_place_error(path) do
    Error.new(:not_a_file, "#{path} is a store, which is repaired in place",
      why: "only an MCAP file is recovered into another file",
      fix: "run `situ store repair '#{path}'`, or copy it first"
    )
  end

  defp recover(path, out, opts) do
    if opts[:dry_run] do
      throw(
        {:usage, "--dry-run is only for stores; `situ store verify '#{path}'` shows the damage"}
      )
    end

    Saving.save(%{path: path, file: out}, [{:skip_damage, true} | opts])
  end

  defp repair(path, opts) do
    dry? = opts[:dry_run] == true

    report =
      Progress.show("repair", opts, fn progress ->
        ok!(Store.repair(path, dry_run: dry?, progress: progress))
      end)

    if opts[:json] do
      Output.json(report)
    else
      Output.puts(
        "#{report.kept} chunks kept (#{report.recovered} of them recovered), #{report.dropped} lost"
      )

      places(report.damage)
      if report.unconfirmed > 0, do: Output.puts(describe_unconfirmed(report.unconfirmed))
      Output.puts(done(report, dry?))
    end

    0
  end

  defp describe_unconfirmed(n) do
    "#{Output.number(n, "chunk")} at the end omitted. Its data is intact, but without the lost index it is unknown " <>
      "whether the writer had acknowledged it."
  end

  defp done(_report, true), do: "Nothing was changed (--dry-run)."

  defp done(%{rebuilt?: true}, _dry?),
    do: "The index was rebuilt; an old one is kept as index.situ.before-repair."

  defp done(_report, _dry?), do: "The store is complete and closed."

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end
