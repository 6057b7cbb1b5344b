defmodule Situ.CLI.Store.Repair do
  @moduledoc false
  # Implements `situ store verify` and `situ store repair`.
  alias Situ.CLI.{Output, Progress}
  alias Situ.CLI.Store.{ExternalFiles, Export}
  alias Situ.{Error, Store}

  @spec verify_paths([Path.t()], keyword()) :: 0 | 1
  def verify_paths(paths, opts) do
    reports = for path <- paths, do: {path, verify_path(path, opts, length(paths))}
    if opts[:json], do: print_reports_json(reports)
    if Enum.all?(reports, &match?({_, {:ok, %{damage: []}}}, &1)), do: 0, else: 1
  end

  # A path that is not a store must not prevent checks of the other paths.
  defp verify_path(path, opts, n) do
    result =
      Progress.with_progress("verify", opts, fn progress ->
        if File.regular?(path),
          do: ExternalFiles.verify_file(path, progress),
          else: Store.verify(path, progress: progress)
      end)

    if n == 1, do: unwrap!(result)

    if not (opts[:json] || false),
      do: print_result(if(n > 1, do: path <> ": ", else: ""), path, result)

    result
  end

  defp print_result(prefix, _path, {:ok, %{chunks: chunks, damage: []}}),
    do: Output.puts("#{prefix}#{chunks} chunks, all intact")

  defp print_result(prefix, _path, {:ok, %{messages: messages, damage: []}}),
    do: Output.puts("#{prefix}#{messages} messages, all readable")

  defp print_result(prefix, path, {:ok, %{messages: _, damage: damage}}) do
    Output.puts(prefix <> "DAMAGED")
    for %{why: why} <- damage, do: Output.puts("  " <> why)
    Output.puts(external_file_error(path, nil).fix)
  end

  defp print_result(prefix, path, {:ok, %{damage: damage}}) do
    Output.puts(prefix <> "DAMAGED")
    print_damage(damage)
    Output.puts("`situ store repair '#{path}'` keeps the intact data.")
  end

  defp print_result(prefix, _path, {:error, error}), do: Output.puts(prefix <> error.what)

  # For repeated damage in one file, prints only the first position and the number of others.
  defp print_damage(damage) do
    for [first | more] <- Enum.chunk_by(damage, &{&1.file, &1.why}) do
      also = if more == [], do: "", else: " (and at #{length(more)} more positions)"
      Output.puts("  #{first.file} at byte #{first.offset}: #{first.why}#{also}")
    end
  end

  defp print_reports_json([{_, {:ok, report}}]), do: Output.print_json(report)

  defp print_reports_json(reports) do
    all =
      for {path, result} <- reports do
        case result do
          {:ok, report} -> Map.put(report, :path, path)
          {:error, error} -> %{path: path, error: error.what}
        end
      end

    Output.print_json(all)
  end

  @spec repair_path(Path.t(), Path.t() | nil, keyword()) :: 0
  def repair_path(path, out, opts) do
    cond do
      File.regular?(path) and mcap_file?(path) and out != nil and mcap_file?(out) ->
        recover_mcap(path, out, opts)

      File.regular?(path) ->
        raise external_file_error(path, out)

      out != nil ->
        raise in_place_error(path)

      true ->
        repair_store(path, opts)
    end
  end

  defp mcap_file?(path), do: Export.format_from_extension(path) == :mcap

  defp external_file_error(path, out) do
    fix =
      cond do
        not mcap_file?(path) ->
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

  defp recover_mcap(path, out, opts) do
    if opts[:dry_run] do
      throw(
        {:usage, "--dry-run is only for stores; `situ store verify '#{path}'` shows the damage"}
      )
    end

    Export.save_file(%{path: path, file: out}, [{:skip_damage, true} | opts])
  end

  defp repair_store(path, opts) do
    dry? = opts[:dry_run] == true

    report =
      Progress.with_progress("repair", opts, fn progress ->
        unwrap!(Store.repair(path, dry_run: dry?, progress: progress))
      end)

    if opts[:json] do
      Output.print_json(report)
    else
      Output.puts(
        "#{report.kept} chunks kept (#{report.recovered} of them recovered), #{report.dropped} lost"
      )

      print_damage(report.damage)
      if report.unconfirmed > 0, do: Output.puts(unconfirmed_note(report.unconfirmed))
      Output.puts(repair_outcome(report, dry?))
    end

    0
  end

  defp unconfirmed_note(n) do
    "#{Output.format_count(n, "chunk")} at the end omitted. Its data is intact, but without the lost index " <>
      "it is unknown whether the writer had acknowledged it."
  end

  defp repair_outcome(_report, true), do: "Nothing was changed (--dry-run)."

  defp repair_outcome(%{rebuilt?: true}, _dry?),
    do: "The index was rebuilt; an old one is kept as index.situ.before-repair."

  defp repair_outcome(_report, _dry?), do: "The store is complete and closed."

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end
