defmodule Situ.CLITest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO
  alias Situ.CLI.{Commands, Completion, Manual, Option, Verb}

  doctest Situ.CLI
  doctest Situ.CLI.Option

  defp run(argv), do: with_io(fn -> Situ.CLI.run(argv) end)

  test "help lists every command" do
    {0, help} = run(["--help"])
    assert help =~ "Usage: situ COMMAND"
    for verb <- Commands.list_verbs(), do: assert(help =~ ~r/^  #{hd(verb.words)} /m)
  end

  test "a missing command is wrong usage" do
    assert {2, text} = run([])
    assert text =~ "Usage"
  end

  test "reports an unknown command and exits with 2" do
    message = capture_io(:stderr, fn -> assert Situ.CLI.run(["stroe"]) == 2 end)
    assert message =~ ~s(unknown command "stroe")
    assert message =~ "`situ store`"
  end

  test "the help of every verb shows its options and valid examples" do
    for verb <- Commands.list_verbs() do
      {0, text} = run(verb.words ++ ["--help"])
      assert text =~ Verb.usage_line(verb)
      for option <- Verb.all_options(verb), do: assert(text =~ Option.label(option))
      for line <- String.split(text, "\n"), do: assert(String.length(line) <= 130)

      for "situ " <> _ = example <- verb.examples,
          do: assert(example =~ Enum.join(verb.words, " "))
    end
  end

  test "verbs and options have unique names" do
    names =
      Enum.flat_map(Commands.list_verbs(), fn v ->
        [v.words | Enum.map(v.aliases, &[hd(v.words), &1])]
      end)

    assert names == Enum.uniq(names)

    for verb <- Commands.list_verbs() do
      options = Verb.all_options(verb)
      assert Enum.uniq_by(options, & &1.name) == options
      shorts = for %{short: short} <- options, short, do: short
      assert shorts == Enum.uniq(shorts)
    end
  end

  @tag :tmp_dir
  test "completion scripts are valid and know all verbs and options", %{tmp_dir: root} do
    for shell <- Completion.supported_shells() do
      {0, script} = run(["completion", shell])
      for verb <- Commands.list_verbs(), word <- verb.words, do: assert(script =~ word)
      path = Path.join(root, shell)
      File.write!(path, script)
      program = System.find_executable(shell)
      if program, do: assert({_, 0} = System.cmd(program, ["-n", path], stderr_to_stdout: true))
    end

    assert capture_io(:stderr, fn -> assert Situ.CLI.run(["completion", "csh"]) == 1 end) =~
             "bash, zsh, fish"
  end

  @tag :tmp_dir
  test "bash completes commands, verbs, options and their values", %{tmp_dir: root} do
    {0, script} = run(["completion", "bash"])
    path = Path.join(root, "situ.bash")
    File.write!(path, script)

    for {words, wanted} <- [
          {["situ", "sto"], ["store"]},
          {["situ", "store", "cr"], ["crop"]},
          {["situ", "store", "crop", "--st"], ["--start", "--stream"]},
          {["situ", "store", "copy", "a", "b", "--compression", "l"], ["lz4"]}
        ] do
      quoted = Enum.map_join(words, " ", &"'#{&1}'")

      code =
        "source #{path}; COMP_WORDS=(#{quoted}); COMP_CWORD=#{length(words) - 1}; " <>
          "_situ 2>/dev/null; echo ${COMPREPLY[@]}"

      {text, 0} = System.cmd("bash", ["-c", code])
      assert text |> String.split() |> Enum.sort() == wanted
    end
  end

  test "the manual page contains all options of the help" do
    page = Manual.render_page(Commands.list_verbs(), "1")

    for verb <- Commands.list_verbs(),
        option <- verb.options,
        do: assert(page =~ String.replace(Option.label(option), "-", "\\-"))

    refute page =~ ~r/^\.(?!TH|SH|SS|B|I|PP|TP)/m
  end

  test "an internal fault is not reported as the user's mistake" do
    verb = %Verb{words: ["x"], summary: "", run: fn _, _ -> :erlang.error({:badkey, :x}) end}
    assert verb.run

    said =
      capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "rename", "/", <<0>>]) == 1 end)

    assert said =~ "situ: "
  end
end
