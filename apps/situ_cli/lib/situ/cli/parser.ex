defmodule Situ.CLI.Parser do
  @moduledoc false
  # Parses a command line according to a verb's table.
  alias Situ.CLI.{Option, Verb}

  @spec parse(Verb.t(), [String.t()]) :: {:ok, map(), keyword()} | :help | {:error, String.t()}
  def parse(%Verb{} = verb, argv) do
    options = Verb.all_options(verb)

    strict =
      for option <- options,
          do: {option.name, if(option.type == :flag, do: :boolean, else: :keep)}

    aliases = for %{short: short, name: name} <- options, short, do: {short, name}

    # Options end at "--". A command line that contains --help shows the help, even if it has errors.
    case OptionParser.parse(argv, strict: strict, aliases: aliases) do
      {switches, words, invalid} ->
        cond do
          switches[:help] -> :help
          invalid != [] -> {:error, unknown_option(hd(invalid), options)}
          true -> parse_values(verb, options, switches, words)
        end
    end
  end

  defp parse_values(verb, options, switches, words) do
    with {:ok, options} <- parse_options(options, switches, []),
         {:ok, arguments} <- parse_arguments(verb, words) do
      {:ok, arguments, options}
    end
  end

  defp parse_options([], _switches, done), do: {:ok, done}

  defp parse_options([%{name: :help} | rest], switches, done),
    do: parse_options(rest, switches, done)

  defp parse_options([option | rest], switches, done) do
    case option_value(option, Keyword.get_values(switches, option.name)) do
      {:ok, nil} -> parse_options(rest, switches, done)
      {:ok, value} -> parse_options(rest, switches, [{option.name, value} | done])
      {:error, why} -> {:error, why}
    end
  end

  defp option_value(%{type: :flag} = option, []),
    do: {:ok, if(option.negated?, do: true, else: false)}

  defp option_value(%{type: :flag}, texts), do: {:ok, List.last(texts)}
  defp option_value(%{many?: true}, []), do: {:ok, []}
  defp option_value(%{many?: true} = option, texts), do: parse_repeated(option, texts, [])
  defp option_value(option, []), do: {:ok, option.default}
  defp option_value(option, [text]), do: Option.parse_value(option, text)

  defp option_value(option, _),
    do: {:error, "#{Option.switch_name(option)} is given more than once, but takes one value"}

  defp parse_repeated(_option, [], done), do: {:ok, Enum.reverse(done)}

  defp parse_repeated(option, [text | rest], done) do
    with {:ok, value} <- Option.parse_value(option, text),
         do: parse_repeated(option, rest, [value | done])
  end

  defp unknown_option({switch, nil}, options) do
    known = Enum.map(options, &Option.switch_name/1)

    case Enum.find(options, &(switch in [Option.switch_name(&1), "-#{&1.short}"])) do
      nil -> "unknown option #{switch}#{suggest_switch(switch, known)}"
      option -> "#{switch} needs a value: #{Option.label(option)}"
    end
  end

  defp unknown_option({switch, value}, _options),
    do: "#{switch} does not accept the value #{inspect(value)}"

  defp suggest_switch(switch, known) do
    case Situ.Options.nearest_name(switch, known) do
      nil -> ""
      near -> "; did you mean #{near}?"
    end
  end

  # The only argument that takes many words gets all words that the other arguments do not need.
  defp parse_arguments(%{arguments: specs} = verb, words) do
    needed = Enum.count(specs, fn {_, spec} -> not (spec[:optional] || false) end)
    many? = Enum.any?(specs, fn {_, spec} -> spec[:many] end)

    cond do
      length(words) < needed ->
        {:error, missing_argument(verb, Enum.at(required_arguments(specs), length(words)))}

      length(words) > length(specs) and not many? ->
        {:error, extra_argument(verb, Enum.at(words, length(specs)))}

      true ->
        {:ok, assign_words(specs, Enum.map(words, & &1), length(words) - needed)}
    end
  end

  defp required_arguments(specs), do: Enum.reject(specs, fn {_, spec} -> spec[:optional] end)

  defp assign_words([], _words, _spare), do: %{}

  defp assign_words([{name, spec} | specs], words, spare) do
    own = if spec[:optional], do: 0, else: 1

    {argument, words, spare} =
      cond do
        spec[:many] ->
          {argument, words} = Enum.split(words, own + spare)
          {argument, words, 0}

        spec[:optional] == true and spare == 0 ->
          {nil, words, spare}

        true ->
          {hd(words), tl(words), if(spec[:optional], do: spare - 1, else: spare)}
      end

    Map.put(assign_words(specs, words, spare), name, argument)
  end

  defp missing_argument(verb, {name, spec}),
    do:
      "#{Verb.argument_label(name, spec)} is missing (#{spec[:doc]}); usage: #{Verb.usage_line(verb)}"

  defp extra_argument(verb, word),
    do: "#{inspect(word)} is one argument too many; usage: #{Verb.usage_line(verb)}"
end
