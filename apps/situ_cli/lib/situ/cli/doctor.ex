defmodule Situ.CLI.Doctor do
  @moduledoc false
  # `situ doctor`: reports the installed and the missing parts, with the commands that install them.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Output, Verb}
  alias Situ.CLI.Doctor.{Check, Checks}
  alias Situ.Media.Device

  @impl true
  def verbs do
    [
      %Verb{
        words: ["doctor"],
        summary: "report installed and missing programs, libraries and models, and the devices",
        about: """
        Checks the programs, libraries and models that Situ uses on this machine, and lists its devices. It changes
        nothing. Exits with status 1 if a part is missing that most programs need.
        """,
        examples: ["situ doctor", "situ doctor --json"],
        run: &run_checks/2
      }
    ]
  end

  defp run_checks(_arguments, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_cli)
    checks = Checks.run_all()
    devices = Device.list()

    if opts[:json],
      do:
        Output.print_json(%{
          checks: Enum.map(checks, &Map.from_struct/1),
          devices: name_devices(devices)
        }),
      else: print_report(checks, devices)

    if Enum.any?(checks, &Check.required_and_missing?/1), do: 1, else: 0
  end

  defp name_devices(devices), do: for(d <- devices, do: %{id: d.id, kind: d.kind, name: d.name})

  defp print_report(checks, devices) do
    Output.puts("Situ #{Situ.CLI.version()}, #{describe_machine()}\n")

    for {group, checks} <- Enum.chunk_by(checks, & &1.group) |> Enum.map(&{hd(&1).group, &1}) do
      Output.puts(group)
      for check <- checks, line <- Check.format_lines(check), do: Output.puts("  " <> line)
    end

    Output.puts("Devices")
    Output.puts("  " <> describe_devices(devices))
    Output.puts("\n" <> advice(checks))
  end

  defp describe_machine do
    memory = with {:ok, text} <- File.read("/proc/meminfo"), do: memory_total(text)
    cores = System.schedulers_online()

    "Elixir #{System.version()}, OTP #{System.otp_release()}, #{Output.format_count(cores, "core")}#{memory}"
  end

  defp memory_total(text) do
    case Regex.run(~r/^MemTotal:\s+(\d+) kB/m, text) do
      [_, kilobytes] -> ", #{div(String.to_integer(kilobytes), 1_048_576)} GB of memory"
      nil -> ""
    end
  end

  defp describe_devices([]),
    do: "none found; `situ devices` explains how to replay a file as a camera or microphone"

  defp describe_devices(devices) do
    counts = devices |> Enum.frequencies_by(& &1.kind) |> Enum.sort()

    list =
      Enum.map_join(counts, ", ", fn {kind, count} ->
        Output.format_count(count, kind |> Atom.to_string() |> String.replace("_", " "))
      end)

    list <> "; `situ devices` lists them"
  end

  defp advice(checks) do
    case Enum.filter(checks, &(&1.status == :missing)) do
      [] ->
        "Everything is installed. To begin: situ new lobby"

      missing ->
        fixes = missing |> Enum.map(& &1.fix) |> Enum.uniq()

        if Enum.any?(missing, &Check.required_and_missing?/1),
          do: "Run this first:\n" <> indent(required_fixes(missing)),
          else:
            "Everything that most programs need is installed. To begin: situ new lobby\nFor the rest:\n" <>
              indent(fixes)
    end
  end

  defp required_fixes(missing),
    do:
      missing |> Enum.filter(&Check.required_and_missing?/1) |> Enum.map(& &1.fix) |> Enum.uniq()

  defp indent(lines), do: Enum.map_join(lines, "\n", &("  " <> &1))
end
