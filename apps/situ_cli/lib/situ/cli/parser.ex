defmodule Situ.CLI.Parser do
  @moduledoc false
  # Parses a command line according to a verb's table.
  alias Situ.CLI.{Option, Verb}

  @spec parse(Verb.t(), [String.t()]) :: {:ok, map(), keyword()} | :help | {:error, String.t()}
  def parse(%Verb{} = verb, argv) do
    options = Verb.options(verb)

    strict =
      for option <- options,
          do: {option.name, if(option.type == :flag, do: :boolean, else: :keep)}

    aliases = for %{short: short, name: name} <- options, short, do: {short, name}

    # Options end at "--". A command line that contains --help shows the help, even if it has errors.
    case OptionParser.parse(argv, strict: strict, aliases: aliases) do
      {given, words, invalid} ->
        cond do
          given[:help] -> :help
          invalid != [] -> {:error, unknown(hd(invalid), options)}
          true -> read(verb, options, given, words)
        end
    end
  end

  defp read(verb, options, given, words) do
    with {:ok, options} <- options(options, given, []),
         {:ok, arguments} <- arguments(verb, words) do
      {:ok, arguments, options}
    end
  end

  defp options([], _given, done), do: {:ok, done}
  defp options([%{name: :help} | rest], given, done), do: options(rest, given, done)

  defp options([option | rest], given, done) do
    case values(option, Keyword.get_values(given, option.name)) do
      {:ok, nil} -> options(rest, given, done)
      {:ok, value} -> options(rest, given, [{option.name, value} | done])
      {:error, why} -> {:error, why}
    end
  end

  defp values(%{type: :flag} = option, []), do: {:ok, if(option.negated?, do: true, else: false)}
  defp values(%{type: :flag}, given), do: {:ok, List.last(given)}
  defp values(%{many?: true}, []), do: {:ok, []}
  defp values(%{many?: true} = option, given), do: all(option, given, [])
  defp values(option, []), do: {:ok, option.default}
  defp values(option, [text]), do: Option.read(option, text)

  defp values(option, _),
    do: {:error, "#{Option.switch(option)} is given more than once, but takes one value"}

  defp all(_option, [], done), do: {:ok, Enum.reverse(done)}

  defp all(option, [text | rest], done) do
    with {:ok, value} <- Option.read(option, text), do: all(option, rest, [value | done])
  end

  defp unknown({switch, nil}, options) do
    known = Enum.map(options, &Option.switch/1)

    case Enum.find(options, &(switch in [Option.switch(&1), "-#{&1.short}"])) do
      nil -> "unknown option #{switch}#{near(switch, known)}"
      option -> "#{switch} needs a value: #{Option.label(option)}"
    end
  end

  defp unknown({switch, value}, _options),
    do: "#{switch} does not accept the value #{inspect(value)}"

  defp near(switch, known) do
    case Situ.Options.nearest(switch, known) do
      nil -> ""
      near -> "; did you mean #{near}?"
    end
  end

  # The only argument that takes many words gets all words that the other arguments do not need.
  defp arguments(%{arguments: specs} = verb, words) do
    needed = Enum.count(specs, fn {_, spec} -> not (spec[:optional] || false) end)
    many? = Enum.any?(specs, fn {_, spec} -> spec[:many] end)

    cond do
      length(words) < needed ->
        {:error, missing(verb, Enum.at(needed(specs), length(words)))}

      length(words) > length(specs) and not many? ->
        {:error, extra(verb, Enum.at(words, length(specs)))}

      true ->
        {:ok, spread(specs, Enum.map(words, & &1), length(words) - needed)}
    end
  end

  defp needed(specs), do: Enum.reject(specs, fn {_, spec} -> spec[:optional] end)

  defp spread([], _words, _spare), do: %{}

  defp spread([{name, spec} | specs], words, spare) do
    own = if spec[:optional], do: 0, else: 1

    {taken, words, spare} =
      cond do
        spec[:many] ->
          {taken, words} = Enum.split(words, own + spare)
          {taken, words, 0}

        spec[:optional] == true and spare == 0 ->
          {nil, words, spare}

        true ->
          {hd(words), tl(words), if(spec[:optional], do: spare - 1, else: spare)}
      end

    Map.put(spread(specs, words, spare), name, taken)
  end

  defp missing(verb, {name, spec}),
    do: "#{Verb.argument(name, spec)} is missing (#{spec[:doc]}); usage: #{Verb.usage(verb)}"

  defp extra(verb, word),
    do: "#{inspect(word)} is one argument too many; usage: #{Verb.usage(verb)}"
end
