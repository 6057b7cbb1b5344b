defmodule Situ.CLI.New.Example do
  @moduledoc false
  # The examples in the folder `examples` of this Situ, as the files of a new project: the project's name replaces the
  # example's, and the path of Situ the relative path.
  alias Situ.CLI.Checkout
  alias Situ.CLI.New.Name
  alias Situ.{Error, Options}

  # Folders that mix and the tests create.
  @made ["_build", "deps", "tmp"]
  # Files with text in which names are replaced.
  @texts [".ex", ".exs", ".md", ".json", ".py"]
  @relative ~s|Path.expand("../..", __DIR__)|

  @doc "Returns the names of the examples."
  @spec list_names() :: [String.t()]
  def list_names do
    for mix <- Path.wildcard(Path.join(folder(), "*/mix.exs")),
        do: mix |> Path.dirname() |> Path.basename()
  end

  defp folder, do: Path.join(Checkout.folder(), "examples")

  @doc "Returns the files of a project that is a copy of an example. Error: `:no_example`."
  @spec project_files(String.t(), Name.t(), Path.t()) ::
          {:ok, [{Path.t(), binary()}]} | {:error, Error.t()}
  def project_files(example, %Name{} = name, situ) do
    if example in list_names() do
      root = Path.join(folder(), example)
      replacements = [{@relative, inspect(situ)} | name_replacements(example, name)]
      {:ok, for(path <- list_files(root), do: read_file(root, path, replacements))}
    else
      {:error, no_example_error(example)}
    end
  end

  defp name_replacements(example, name),
    do: [{example, name.file}, {Macro.camelize(example), name.module}]

  defp list_files(root) do
    for path <- root |> Path.join("**") |> Path.wildcard(match_dot: true) |> Enum.sort(),
        File.regular?(path),
        relative = Path.relative_to(path, root),
        hd(Path.split(relative)) not in @made,
        do: relative
  end

  defp read_file(root, path, [_ | names] = replacements) do
    content = root |> Path.join(path) |> File.read!()
    text = if Path.extname(path) in @texts, do: replace(content, replacements), else: content
    {replace(path, names), text}
  end

  defp replace(text, replacements),
    do: Enum.reduce(replacements, text, fn {from, to}, text -> String.replace(text, from, to) end)

  defp no_example_error(example) do
    near = Options.nearest_name(example, list_names())
    hint = if near, do: "did you mean #{near}? ", else: ""

    Error.new(:no_example, "example #{inspect(example)} does not exist",
      fix: hint <> "The examples are: #{Enum.join(list_names(), ", ")}"
    )
  end
end
