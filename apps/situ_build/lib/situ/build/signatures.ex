defmodule Situ.Build.Signatures do
  @moduledoc false
  # The recorded list of public signatures, which `docs/versions.md` promises to keep.
  #
  # `docs/signatures.txt` has the signatures of the last version. A signature that the code no longer has must be named
  # in the changelog, and from 1.0.0 on, a stable one must have been deprecated before a major version removes it. See
  # docs/adr/0004-signatures-are-recorded.md.
  alias Situ.Build.{ModuleDocs, PublicModules}

  @file_name "docs/signatures.txt"
  @sections ["Before you upgrade", "Changed", "Removed"]

  @typedoc "`words` must all be in one entry of the changelog that names this signature."
  @type t :: %{text: String.t(), status: String.t(), deprecated?: boolean(), words: [String.t()]}

  @doc "Returns one sentence for each signature that changed without an entry in the changelog of the checkout."
  @spec find_violations(Path.t(), Path.t(), String.t()) :: [String.t()]
  def find_violations(root, lib, version) do
    {recorded_version, recorded} = root |> Path.join(@file_name) |> File.read!() |> parse_file()
    entries = root |> Path.join("CHANGELOG.md") |> File.read!() |> unreleased_entries()
    compare(recorded, read_all(root, lib), entries, {recorded_version, version})
  end

  @doc "Writes the signatures of the compiled modules in `lib`."
  @spec write_file(Path.t(), Path.t(), String.t(), Path.t() | nil) :: :ok
  def write_file(root, lib, version, path \\ nil) do
    lines = for signature <- read_all(root, lib), do: [format_line(signature), "\n"]

    header = """
    # Public signatures, recorded by `mix situ.check --write-signatures`. docs/versions.md promises to keep them, and
    # `mix situ.check` compares them with the code. A release records them again.
    version #{version}
    """

    File.write!(path || Path.join(root, @file_name), [header | lines])
  end

  @doc "Returns the signatures of the compiled public modules in `lib`, and of the command line."
  @spec read_all(Path.t(), Path.t()) :: [t()]
  def read_all(root, lib) do
    statuses = root |> Path.join("docs/api.md") |> File.read!() |> PublicModules.parse_list()
    modules = ModuleDocs.read_all(lib, statuses |> Map.keys() |> Enum.sort())

    Enum.flat_map(modules, &module_signatures(&1, statuses[&1.name])) ++ command_signatures()
  end

  defp module_signatures(module, status) do
    functions =
      for entry <- module.entries, arity <- entry.arities do
        name = "#{kind_prefix(entry.kind)}#{module.name}.#{entry.name}/#{arity}"
        build_signature(name, status, ["#{module.name}.#{entry.name}/#{arity}"], entry.deprecated)
      end

    fields =
      for field <- module.fields || [],
          do: build_signature("%#{module.name}{#{field}}", status, [module.name, "#{field}"])

    options =
      for {option, spec} <- component_options(module.name) do
        text = "#{module.name} option #{option}: #{describe_option(spec)}"
        build_signature(text, status, [module.name, "#{option}"])
      end

    Enum.sort_by(functions ++ fields ++ options, & &1.text)
  end

  defp kind_prefix(:type), do: "t:"
  defp kind_prefix(kind) when kind in [:callback, :macrocallback], do: "c:"
  defp kind_prefix(_kind), do: ""

  defp build_signature(text, status, words, deprecated \\ nil),
    do: %{text: text, status: status, deprecated?: deprecated != nil, words: words}

  # Components return the schema of their options.
  defp component_options(name) do
    module = Module.concat([name])

    if Code.ensure_loaded?(module) and function_exported?(module, :options, 0),
      do: module.options(),
      else: []
  end

  defp describe_option(spec) do
    type = inspect(spec[:type] || :any, limit: :infinity)
    default = if Keyword.has_key?(spec, :default), do: " = " <> inspect(spec[:default])
    required = if spec[:required], do: " required"
    String.replace("#{type}#{default}#{required}", ~r/(#Function<)[^>]*>/, "\\1>")
  end

  # The build tool uses no application, so it finds the table of commands by its name.
  defp command_signatures do
    for verb <- Module.concat(["Situ.CLI.Commands"]).list_verbs(),
        command = Enum.join(["situ" | verb.words], " "),
        {detail, words} <- [{"", []} | arguments(verb) ++ options(verb)],
        do: build_signature(String.trim("#{command} #{detail}"), "command", [command | words])
  end

  defp arguments(verb) do
    for {name, _} <- verb.arguments,
        word = name |> to_string() |> String.upcase(),
        do: {word, [word]}
  end

  defp options(verb) do
    for option <- verb.options do
      label = Module.concat(["Situ.CLI.Option"]).label(option)
      {label, [~r/--[a-z0-9-]+/ |> Regex.run(label) |> hd()]}
    end
  end

  defp format_line(signature) do
    deprecated = if signature.deprecated?, do: " (deprecated)", else: ""
    "#{signature.status} #{signature.text}#{deprecated}"
  end

  @doc """
  Parses the recorded signatures.

      iex> Situ.Build.Signatures.parse_file("version 1.2.0\\nstable A.f/1 (deprecated)\\n")
      {"1.2.0", [%{text: "A.f/1", status: "stable", deprecated?: true, words: ["A.f/1"]}]}
  """
  @spec parse_file(String.t()) :: {String.t(), [t()]}
  def parse_file(text) do
    ["version " <> version | lines] =
      text |> String.split("\n", trim: true) |> Enum.reject(&String.starts_with?(&1, "#"))

    {version, Enum.map(lines, &parse_line/1)}
  end

  defp parse_line(line) do
    [status, text] = String.split(line, " ", parts: 2)
    bare = String.replace_suffix(text, " (deprecated)", "")
    %{text: bare, status: status, deprecated?: bare != text, words: entry_words(bare)}
  end

  # The words of a recorded signature follow from its text.
  defp entry_words("situ " <> _ = text) do
    [command] = Regex.run(~r/^situ(?: [a-z-]+)+/, text)
    rest = text |> String.replace_prefix(command, "") |> String.trim()
    [command | Regex.run(~r/--[a-z0-9-]+|^[A-Z_]+/, rest) || []]
  end

  defp entry_words("%" <> rest) do
    [module, field] = String.split(rest, "{")
    [module, String.trim_trailing(field, "}")]
  end

  defp entry_words(text) do
    case Regex.run(~r/^([\w.]+) option ([^:]+):/, text) do
      [_, module, option] -> [module, option]
      nil -> [String.replace(text, ~r/^[ct]:/, "")]
    end
  end

  @doc """
  Returns one sentence for each recorded signature that is missing without permission.

      iex> {_, old} = Situ.Build.Signatures.parse_file("version 0.1.0\\nstable A.f/1\\nstable A.g/0\\n")
      iex> Situ.Build.Signatures.compare(old, [], ["`A.f/1` is now `A.h/1`."], {"0.1.0", "0.2.0"})
      ["A.g/0 changed or disappeared: name `A.g/0` in one entry of CHANGELOG.md under Changed or Removed"]
      iex> Situ.Build.Signatures.compare(old, [], ["`A.f/1`, `A.g/0`"], {"1.0.0", "1.1.0"}) |> hd()
      "A.f/1 is stable and disappeared: a minor version keeps it; deprecate it, and remove it in version 2.0.0"

  A choice that has gained values is kept:

      iex> {_, old} = Situ.Build.Signatures.parse_file("version 1.0.0\\ncommand situ save --format csv|json\\n")
      iex> {_, new} = Situ.Build.Signatures.parse_file("version 1.1.0\\ncommand situ save --format csv|db3|json\\n")
      iex> new = Enum.map(new, &%{&1 | words: ["situ save", "--format"]})
      iex> Situ.Build.Signatures.compare(old, new, [], {"1.0.0", "1.1.0"})
      []
  """
  @spec compare([t()], [t()], [String.t()], {String.t(), String.t()}) :: [String.t()]
  def compare(recorded, present, entries, versions) do
    kept = Map.new(present, &{&1.text, &1.status})

    for signature <- recorded,
        missing?(signature, kept[signature.text]),
        not Enum.any?(present, &extends?(&1, signature)),
        problem = judge_missing(signature, entries, versions),
        do: problem
  end

  # The option `--format csv|json` of a command may gain values.
  defp extends?(%{status: status} = present, %{status: status} = old) do
    {before, old_values} = split_choice(old.text)
    {now, values} = split_choice(present.text)
    old_values != [] and before == now and old_values -- values == []
  end

  defp extends?(_present, _old), do: false

  defp split_choice(text) do
    {last, rest} = text |> String.split(" ") |> List.pop_at(-1)
    if String.contains?(last, "|"), do: {rest, String.split(last, "|")}, else: {text, []}
  end

  # Experimental modules may become stable.
  defp missing?(%{status: "experimental"}, status), do: status not in ["experimental", "stable"]
  defp missing?(%{status: recorded}, status), do: status != recorded

  defp judge_missing(signature, entries, {recorded, version}) do
    {old, new} = {Version.parse!(recorded), Version.parse!(version)}

    cond do
      old.major >= 1 and signature.status != "experimental" and
          (new.major == old.major or not signature.deprecated?) ->
        "#{signature.text} is #{signature.status} and disappeared: a minor version keeps it; " <>
          "deprecate it, and remove it in version #{old.major + 1}.0.0"

      Enum.any?(entries, &names_signature?(&1, signature.words)) ->
        nil

      true ->
        "#{signature.text} changed or disappeared: name #{format_words(signature.words)} in one entry of " <>
          "CHANGELOG.md under Changed or Removed"
    end
  end

  defp format_words(words), do: Enum.map_join(words, " and ", &"`#{&1}`")

  defp names_signature?(entry, words), do: Enum.all?(words, &String.contains?(entry, &1))

  @doc """
  Returns the entries of the unreleased version that may describe changed names.

      iex> Situ.Build.Signatures.unreleased_entries(\"""
      ...> ## Unreleased
      ...> ### Added
      ...> - **A**: x
      ...> ### Changed
      ...> - **B**: y
      ...>   and z
      ...> ## 0.1.0
      ...> ### Changed
      ...> - old
      ...> \""")
      ["**B**: y and z"]
  """
  @spec unreleased_entries(String.t()) :: [String.t()]
  def unreleased_entries(changelog) do
    [_, unreleased | _] = String.split(changelog, ~r/^## /m)

    for section <- String.split(unreleased, ~r/^### /m),
        [title, text] = String.split(section, "\n", parts: 2),
        String.trim(title) in @sections,
        entry <- text |> String.split(~r/^- /m) |> tl(),
        do: entry |> String.replace(~r/\s+/, " ") |> String.trim()
  end
end
