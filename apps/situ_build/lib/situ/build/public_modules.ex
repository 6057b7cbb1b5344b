defmodule Situ.Build.PublicModules do
  @moduledoc false
  # Compares the list of public modules in `docs/api.md` with the modules that have documentation.
  #
  # A module is public if it has a `@moduledoc`. A list that is checked is a promise that people can read in one place;
  # without the check, each new module with documentation would silently become part of the API. Guides and the
  # documentation of public modules may name only public modules.

  @list "docs/api.md"
  @guides ["README.md", "docs/scaling.md", "docs/guides/*.md"]
  # Programs for reading and tools for building Situ are documented, but nobody depends on them.
  @exempt [:situ_build, :situ_examples]

  @doc "Returns one sentence for each difference between the list of the checkout and the modules compiled in `lib`."
  @spec find_violations(Path.t(), Path.t(), [atom()]) :: [String.t()]
  def find_violations(root, lib, apps) do
    listed = root |> Path.join(@list) |> File.read!() |> parse_list()
    modules = for app <- apps -- @exempt, path <- list_beams(lib, app), do: read_docs(path)
    kinds = Map.new(modules, &{&1.name, &1.kind})

    guides =
      for pattern <- @guides, path <- Path.wildcard(Path.join(root, pattern)) do
        {Path.relative_to(path, root), File.read!(path)}
      end

    compare(listed, kinds) ++
      find_private_names(guides ++ Enum.flat_map(modules, & &1.texts), kinds)
  end

  @doc """
  Parses the tables of the list.

      iex> Situ.Build.PublicModules.parse_list("| `Situ.Time` | stable | Points in time |")
      %{"Situ.Time" => "stable"}
  """
  @spec parse_list(String.t()) :: %{String.t() => String.t()}
  def parse_list(text) do
    for [_, name, status] <- Regex.scan(~r/^\| `([A-Z][\w.]*)` \| (\w+) \|/m, text),
        into: %{},
        do: {name, status}
  end

  @doc """
  Returns one sentence for each difference.

      iex> listed = %{"A" => "stable", "B" => "new", "X" => "stable"}
      iex> Situ.Build.PublicModules.compare(listed, %{"A" => :none, "B" => :hidden, "C" => :text})
      ["A has neither a @moduledoc nor `@moduledoc false`", "B is listed in docs/api.md but has `@moduledoc false`",
       "B must be stable or experimental in docs/api.md, not \\"new\\"",
       "C has a @moduledoc but is not listed in docs/api.md", "X is listed in docs/api.md but does not exist"]
  """
  @spec compare(%{String.t() => String.t()}, %{String.t() => :text | :hidden | :none}) :: [
          String.t()
        ]
  def compare(listed, modules) do
    unknown =
      for {name, _} <- listed,
          not is_map_key(modules, name),
          do: "#{name} is listed in #{@list} but does not exist"

    statuses =
      for {name, status} <- listed, status not in ~w(stable experimental) do
        "#{name} must be stable or experimental in #{@list}, not #{inspect(status)}"
      end

    docs = for {name, doc} <- modules, problem = check_module(name, doc, listed), do: problem
    Enum.sort(unknown ++ statuses ++ docs)
  end

  @doc """
  Returns one sentence for each private module that a text names.

      iex> texts = [{"a.md", "`A.B.run/1` uses `A.C`."}]
      iex> Situ.Build.PublicModules.find_private_names(texts, %{"A.B" => :text, "A.C" => :hidden})
      ["a.md names A.C, which is private"]
  """
  @spec find_private_names([{Path.t(), String.t()}], %{String.t() => :text | :hidden | :none}) ::
          [String.t()]
  def find_private_names(texts, modules) do
    for {path, text} <- texts,
        [name] <- ~r/\b[A-Z]\w*(?:\.[A-Z]\w*)+/ |> Regex.scan(text) |> Enum.uniq(),
        modules[name] not in [nil, :text],
        do: "#{path} names #{name}, which is private"
  end

  defp check_module(name, :none, _listed),
    do: "#{name} has neither a @moduledoc nor `@moduledoc false`"

  defp check_module(name, :hidden, listed) when is_map_key(listed, name),
    do: "#{name} is listed in #{@list} but has `@moduledoc false`"

  defp check_module(name, :text, listed) when not is_map_key(listed, name),
    do: "#{name} has a @moduledoc but is not listed in #{@list}"

  defp check_module(_name, _doc, _listed), do: nil

  defp list_beams(lib, app),
    do: Path.wildcard(Path.join([lib, to_string(app), "ebin", "Elixir.Situ*.beam"]))

  # Code that only tests use may do without documentation.
  defp read_docs(path) do
    "Elixir." <> name = Path.basename(path, ".beam")

    {:ok, {_, [{_, docs}, {_, info}]}} =
      :beam_lib.chunks(String.to_charlist(path), ['Docs', :compile_info], [:allow_missing_chunks])

    if docs == :missing_chunk or test_support?(info),
      do: %{name: name, kind: :hidden, texts: []},
      else: describe_docs(name, :erlang.binary_to_term(docs))
  end

  defp describe_docs(name, {:docs_v1, _, _, _, %{"en" => text}, _, functions}) do
    texts =
      for {{kind, function, arity}, _, _, %{"en" => text}, _} when kind != :type <- functions,
          do: {"the documentation of #{name}.#{function}/#{arity}", text}

    %{name: name, kind: :text, texts: [{"the documentation of #{name}", text} | texts]}
  end

  defp describe_docs(name, docs), do: %{name: name, kind: elem(docs, 4), texts: []}

  defp test_support?(info), do: to_string(info[:source]) =~ "/test/support/"
end
