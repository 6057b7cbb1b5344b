defmodule Situ.CLI.Shell do
  @moduledoc false
  # `situ completion` and `situ manual`: print completion scripts for shells, and the manual page.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Commands, Completion, Manual, Option, Verb}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["completion"],
        summary: "print a shell's completion script for situ's commands and options",
        about: """
        bash: source <(situ completion bash)
        zsh: situ completion zsh > "${fpath[1]}/_situ"
        fish: situ completion fish > ~/.config/fish/completions/situ.fish
        """,
        arguments: [shell: [kind: :text, doc: Enum.join(Completion.supported_shells(), ", ")]],
        examples: ["source <(situ completion bash)"],
        run: &print_completion/2
      },
      %Verb{
        words: ["manual"],
        summary: "print the manual page, for man",
        options: [Option.new(:markdown, :flag, "print the help of all commands as Markdown")],
        examples: ["situ manual > ~/.local/share/man/man1/situ.1", "situ manual | man -l -"],
        run: &print_manual/2
      }
    ]
  end

  defp print_completion(%{shell: shell}, _opts) do
    if shell in Completion.supported_shells() do
      IO.write(Completion.render_script(shell, Commands.list_verbs(), Commands.groups()))
      0
    else
      raise Situ.Error.new(:bad_option, "no completion for the shell #{inspect(shell)}",
              fix: "use one of #{Enum.join(Completion.supported_shells(), ", ")}"
            )
    end
  end

  defp print_manual(_args, opts) do
    verbs = Commands.list_verbs()
    version = to_string(Application.spec(:situ_cli, :vsn) || "")

    IO.write(
      if opts[:markdown],
        do: Manual.render_markdown(verbs, Commands.groups()),
        else: Manual.render_page(verbs, version)
    )

    0
  end
end
