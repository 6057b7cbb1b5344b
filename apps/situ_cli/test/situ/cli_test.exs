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
    for verb <- Commands.all(), do: assert(help =~ ~r/^  #{hd(verb.words)} /m)
  end

  test "no command is wrong usage" do
    assert {2, text} = run([])
    assert text =~ "Usage"
  end

  test "an unknown command says so and exits with 2" do
    message = capture_io(:stderr, fn -> assert Situ.CLI.run(["stroe"]) == 2 end)
    assert message =~ ~s(no command "stroe")
    assert message =~ "`situ store`"
  end

  test "every verb explains itself with all of its options, and its examples can be read" do
    for verb <- Commands.all() do
      {0, text} = run(verb.words ++ ["--help"])
      assert text =~ Verb.usage(verb)
      for option <- Verb.options(verb), do: assert(text =~ Option.label(option))
      for line <- String.split(text, "\n"), do: assert(String.length(line) <= 130)

      for "situ " <> _ = example <- verb.examples,
          do: assert(example =~ Enum.join(verb.words, " "))
    end
  end

  test "names of verbs and options are unique" do
    names =
      Enum.flat_map(Commands.all(), fn v ->
        [v.words | Enum.map(v.aliases, &[hd(v.words), &1])]
      end)

    assert names == Enum.uniq(names)

    for verb <- Commands.all() do
      options = Verb.options(verb)
      assert Enum.uniq_by(options, & &1.name) == options
      shorts = for %{short: short} <- options, short, do: short
      assert shorts == Enum.uniq(shorts)
    end
  end

  @tag :tmp_dir
  test "the completion scripts are sound and know every verb and option", %{tmp_dir: root} do
    for shell <- Completion.shells() do
      {0, script} = run(["completion", shell])
      for verb <- Commands.all(), word <- verb.words, do: assert(script =~ word)
      path = Path.join(root, shell)
      File.write!(path, script)
      program = System.find_executable(shell)
      if program, do: assert({_, 0} = System.cmd(program, ["-n", path], stderr_to_stdout: true))
    end

    assert capture_io(:stderr, fn -> assert Situ.CLI.run(["completion", "csh"]) == 1 end) =~
             "bash, zsh, fish"
  end

  @tag :tmp_dir
  test "bash completes commands, verbs, options and their words", %{tmp_dir: root} do
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

  test "the manual page says all that help says" do
    page = Manual.page(Commands.all(), "1")

    for verb <- Commands.all(),
        option <- verb.options,
        do: assert(page =~ String.replace(Option.label(option), "-", "\\-"))

    refute page =~ ~r/^\.(?!TH|SH|SS|B|I|PP|TP)/m
  end

  test "a fault in situ itself is not dressed up as the user's" do
    verb = %Verb{words: ["x"], summary: "", run: fn _, _ -> :erlang.error({:badkey, :x}) end}
    assert verb.run

    said =
      capture_io(:stderr, fn -> assert Situ.CLI.run(["store", "rename", "/", <<0>>]) == 1 end)

    assert said =~ "situ: "
  end
end
