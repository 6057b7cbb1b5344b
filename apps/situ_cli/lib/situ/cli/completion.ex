defmodule Situ.CLI.Completion do
  @moduledoc false
  # Generates the shells' completion scripts from the verbs' tables. Words and options are written into the script, so
  # that completion does not start a program.
  alias Situ.CLI.{Option, Verb}

  @shells ["bash", "zsh", "fish"]

  @spec supported_shells() :: [String.t()]
  def supported_shells, do: @shells

  @spec render_script(String.t(), [Verb.t()], %{String.t() => String.t()}) :: String.t()
  def render_script("bash", verbs, _groups), do: bash_script(verbs)
  def render_script("zsh", verbs, groups), do: zsh_script(verbs, groups)
  def render_script("fish", verbs, groups), do: fish_script(verbs, groups)

  defp first_words(verbs), do: verbs |> Enum.map(&hd(&1.words)) |> Enum.uniq()

  defp second_words(verbs) do
    for {first, group} <- Enum.group_by(verbs, &hd(&1.words)),
        words = for(%{words: [_, second]} <- group, do: second),
        words != [],
        do: {first, words}
  end

  defp verb_switches(verb), do: verb |> Verb.all_options() |> Enum.flat_map(&option_switches/1)

  defp option_switches(%{negated?: true} = option),
    do: [String.replace_prefix(Option.switch_name(option), "--", "--no-")]

  defp option_switches(option), do: [Option.switch_name(option)]

  defp option_choices(verbs) do
    for verb <- verbs,
        %{type: words} = option when is_list(words) <- verb.options,
        uniq: true,
        do: {Option.switch_name(option), words}
  end

  defp bash_script(verbs) do
    """
    # situ: completion for bash. Use: source <(situ completion bash)
    _situ() {
      local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD-1]}
      COMPREPLY=()
      if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "#{Enum.join(first_words(verbs), " ")} --help --version" -- "$cur"))
        return
      fi
      if [ "$COMP_CWORD" -eq 2 ]; then
        case ${COMP_WORDS[1]} in
    #{map_lines(second_words(verbs), fn {first, words} -> "      #{first}) #{compgen_reply(words)}; return ;;" end)}
        esac
      fi
      case "$prev" in
    #{map_lines(option_choices(verbs), fn {switch, words} -> "    #{switch}) #{compgen_reply(words)}; return ;;" end)}
      esac
      if [[ $cur == -* ]]; then
        case "${COMP_WORDS[1]} ${COMP_WORDS[2]}" in
    #{map_lines(verbs, fn verb -> "      #{case_pattern(verb.words)}) #{compgen_reply(verb_switches(verb))} ;;" end)}
        esac
        return
      fi
      compopt -o filenames
      COMPREPLY=($(compgen -f -- "$cur"))
    }
    complete -F _situ situ bin/situ
    """
  end

  defp map_lines(items, fun), do: Enum.map_join(items, "\n", fun)

  defp compgen_reply(words),
    do: ~s|COMPREPLY=($(compgen -W "#{Enum.join(words, " ")}" -- "$cur"))|

  defp case_pattern([one]), do: ~s("#{one} "*)
  defp case_pattern(words), do: ~s("#{Enum.join(words, " ")}")

  defp zsh_script(verbs, groups) do
    """
    #compdef situ
    # situ: completion for zsh. Use: situ completion zsh > "${fpath[1]}/_situ"
    _situ() {
      local -a words_1
      words_1=(
    #{map_lines(first_words(verbs), &"    #{zsh_item(&1, command_summary(&1, verbs, groups))}")}
      )
      if (( CURRENT == 2 )); then _describe command words_1; return; fi
      local -a verbs_2
      case $words[2] in
    #{map_lines(second_words(verbs), fn {first, _} -> "    #{first}) verbs_2=(#{zsh_verbs(first, verbs)}) ;;" end)}
      esac
      if (( CURRENT == 3 && $#verbs_2 )); then _describe verb verbs_2; return; fi
      case "$words[2] $words[3]" in
    #{map_lines(verbs, &"    #{case_pattern(&1.words)}) _arguments #{zsh_options(&1)} '*:file:_files' ;;")}
        *) _files ;;
      esac
    }
    _situ "$@"
    """
  end

  defp command_summary(word, verbs, groups),
    do: Map.get_lazy(groups, word, fn -> Enum.find(verbs, &(hd(&1.words) == word)).summary end)

  defp zsh_verbs(first, verbs) do
    Enum.join(for(%{words: [^first, second]} = v <- verbs, do: zsh_item(second, v.summary)), " ")
  end

  defp zsh_options(verb), do: Enum.map_join(Verb.all_options(verb), " ", &zsh_option/1)

  defp zsh_item(word, text), do: shell_quote("#{word}:#{String.replace(text, ":", "\\:")}")

  defp zsh_option(option) do
    action =
      case option.type do
        :flag -> ""
        words when is_list(words) -> ":value:(#{Enum.join(words, " ")})"
        :path -> ":path:_files"
        _ -> ":value:"
      end

    text = option.doc |> String.replace(~r/[\[\]:]/, " ")
    many = if option.many?, do: "*", else: ""
    shell_quote("#{many}#{hd(option_switches(option))}[#{text}]#{action}")
  end

  defp shell_quote(text), do: "'" <> String.replace(text, "'", "'\\''") <> "'"

  defp fish_script(verbs, groups) do
    """
    # situ: completion for fish. Use: situ completion fish > ~/.config/fish/completions/situ.fish
    #{map_lines(first_words(verbs), &fish_command(&1, command_summary(&1, verbs, groups)))}
    #{Enum.map_join(verbs, "\n", &fish_verb/1)}
    """
  end

  defp fish_command(word, text),
    do: "complete -c situ -n __fish_use_subcommand -f -a #{word} -d #{shell_quote(text)}"

  defp fish_verb(%{words: words} = verb) do
    seen = Enum.map_join(words, "; and ", &"__fish_seen_subcommand_from #{&1}")

    word =
      case words do
        [first, second] ->
          [
            "complete -c situ -n '__fish_seen_subcommand_from #{first}' -f -a #{second} -d #{shell_quote(verb.summary)}"
          ]

        _ ->
          []
      end

    options =
      for option <- Verb.all_options(verb) do
        "--" <> name = hd(option_switches(option))
        short = if option.short, do: " -s #{option.short}", else: ""

        value =
          case option.type do
            :flag -> ""
            choices when is_list(choices) -> " -x -a #{shell_quote(Enum.join(choices, " "))}"
            _ -> " -r"
          end

        "complete -c situ -n '#{seen}' -l #{name}#{short}#{value} -d #{shell_quote(option.doc)}"
      end

    Enum.join(word ++ options, "\n")
  end
end
