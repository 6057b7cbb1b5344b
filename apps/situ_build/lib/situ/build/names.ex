defmodule Situ.Build.Names do
  @moduledoc false
  # Measures how functions and modules are named. The limits of `Situ.Build.Limits` keep the
  # figures from rising.
  #
  # A function is named by a verb and its object (`put_session`). One word is enough where the
  # module is the object (`Queue.push`) or the word is a term of the field (`join`). No function
  # is named by a bare participle or adverb. The path of a file follows from its module's name. No
  # two modules of an app share their last two words.
  alias Situ.Build.Definitions

  # Words that say neither what a function does nor what it returns.
  @participles ~w(told kept known fresh whole given wanted taken found noted joined named seen done gone rest held
    left free beside place places shown tell say own other others later again awake lost fit fits most least behind
    ready settled handed begun made marked gathered drawn)

  @typedoc """
  `one_word_private` and `one_word_public` are shares of all functions in percent. `mean_letters` is the mean length
  of names. The lists name the offending functions, files and modules.
  """
  @type t :: %{
          one_word_private: float(),
          one_word_public: float(),
          mean_letters: float(),
          participles: [String.t()],
          paths: [String.t()],
          repeated_words: [String.t()]
        }

  @doc "Measures the apps of the checkout at `root`."
  @spec measure(Path.t()) :: t()
  def measure(root) do
    root
    |> Path.join("apps/*/lib/**/*.ex")
    |> Path.wildcard()
    |> Enum.map(&{Path.relative_to(&1, root), Definitions.read(File.read!(&1))})
    |> measure_files()
  end

  @doc """
  Measures the definitions of files, given by their paths.

      iex> file = %{modules: ["Situ.Queue"], functions: [{:public, "push"}, {:private, "drop_oldest"}]}
      iex> names = Situ.Build.Names.measure_files([{"apps/situ/lib/situ/queue.ex", file}])
      iex> {names.one_word_public, names.one_word_private, names.mean_letters, names.paths}
      {100.0, 0.0, 7.5, []}
  """
  @spec measure_files([{Path.t(), Definitions.t()}]) :: t()
  def measure_files(files) do
    functions =
      for {path, %{functions: found}} <- files, {kind, name} <- found, do: {kind, name, path}

    %{
      one_word_private: one_word_share(functions, :private),
      one_word_public: one_word_share(functions, :public),
      mean_letters: mean_letters(functions),
      participles: for({_, name, path} <- functions, participle?(name), do: "#{path}: #{name}"),
      paths:
        for(
          {path, %{modules: [module | _]}} <- files,
          wrong = describe_misplacement(path, module),
          do: wrong
        ),
      repeated_words: repeated_words(files)
    }
  end

  defp one_word_share(functions, kind) do
    names = for {^kind, name, _path} <- functions, do: name
    100 * Enum.count(names, &(not String.contains?(&1, "_"))) / max(length(names), 1)
  end

  defp mean_letters(functions) do
    letters = functions |> Enum.map(fn {_, name, _} -> String.length(name) end) |> Enum.sum()
    letters / max(length(functions), 1)
  end

  defp participle?(name), do: String.trim_trailing(name, "?") in @participles

  # Capital letters inside a word (FFmpeg, ZeroMQ) may be written as one word in a path.
  defp describe_misplacement(path, module) do
    expected = module |> String.split(".") |> Enum.map_join("/", &Macro.underscore/1)
    actual = path |> String.split("/lib/", parts: 2) |> List.last() |> Path.rootname()

    if remove_underscores(actual) != remove_underscores(expected) and
         not String.starts_with?(module, "Mix."),
       do: "#{path} defines #{module}, which belongs in #{expected}.ex"
  end

  defp remove_underscores(path), do: String.replace(path, "_", "")

  # The last word may occur twice (`Mqtt.Sink`, `Ros.Sink`), because its parent tells the modules apart.
  defp repeated_words(files) do
    modules =
      for {path, %{modules: found}} <- files, module <- found, do: {app_name(path), module}

    for {{app, words}, names} <- Enum.group_by(modules, &last_words/1, &elem(&1, 1)),
        names = Enum.uniq(names),
        length(names) > 1,
        do: "#{app}: #{Enum.join(words, ".")} (#{Enum.join(Enum.sort(names), ", ")})"
  end

  defp last_words({app, module}), do: {app, module |> String.split(".") |> Enum.take(-2)}
  defp app_name(path), do: path |> Path.split() |> Enum.at(1)
end
