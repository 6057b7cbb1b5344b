defmodule Situ.CLI.TokenTest do
  # Not async, because all tests share the environment.
  use ExUnit.Case, async: false
  import ExUnit.CaptureIO
  alias Situ.CLI.{Commands, Desktop, Parser, Token}

  @moduletag :tmp_dir

  setup do
    before = Map.take(System.get_env(), ~w(SITU_TOKEN SITU_TOKEN_FILE))

    on_exit(fn ->
      for name <- ~w(SITU_TOKEN SITU_TOKEN_FILE) do
        if before[name], do: System.put_env(name, before[name]), else: System.delete_env(name)
      end
    end)

    System.delete_env("SITU_TOKEN")
  end

  defp told(opts) do
    parent = self()
    text = capture_io(:stderr, fn -> send(parent, {:token, Token.read_token(opts)}) end)
    assert_received {:token, answer}
    {answer, text}
  end

  test "reads a token from a private file without a warning", %{tmp_dir: root} do
    file = Path.join(root, "token")
    File.write!(file, "of-the-file\nnot this\n")
    File.chmod!(file, 0o600)
    assert told(token_file: file) == {{:ok, "of-the-file"}, ""}
    File.chmod!(file, 0o644)
    assert {{:ok, "of-the-file"}, warning} = told(token_file: file)
    assert warning =~ "every user of this machine can read" and warning =~ "chmod 600"
  end

  test "reads the token from the environment if neither option is given" do
    assert told([]) == {{:ok, nil}, ""}
    System.put_env("SITU_TOKEN", "of-the-environment")
    assert told([]) == {{:ok, "of-the-environment"}, ""}
    {:ok, address} = Situ.Link.Address.parse("situ://nowhere/lobby")
    assert {:ok, %{token: "of-the-environment"}} = Situ.Link.Access.new(address, [])
  end

  test "accepts --token, and warns who can read it" do
    assert {{:ok, "on-the-line"}, warning} = told(token: "on-the-line")
    assert warning =~ "every user of this machine" and warning =~ "--token-file"
    refute warning =~ "on-the-line"
  end

  test "rejects two tokens, and a file without a token", %{tmp_dir: root} do
    assert {{:error, %{code: :usage}}, _} = told(token: "a", token_file: "b")
    assert {{:error, %{code: :no_token}}, _} = told(token_file: Path.join(root, "missing"))
  end

  test "the commands that listen accept a token file" do
    for word <- ["studio", "serve"] do
      {:ok, verb, rest} = Commands.find_verb([word, "--token-file", "f", "x"])
      assert {:ok, _, options} = Parser.parse(verb, rest)
      assert options[:token_file] == "f"
    end
  end

  test "warns about a password in an address without printing it" do
    fix = "give --log-credentials FILE"
    warning = capture_io(:stderr, fn -> Token.warn_of_password("nats://me:pass@host:1", fix) end)
    assert warning =~ fix and not (warning =~ "pass@")
    assert capture_io(:stderr, fn -> Token.warn_of_password("nats://host:1", fix) end) == ""
  end

  test "passes no token on the command line of the desktop's browser", %{tmp_dir: root} do
    page = Desktop.opener_argument("http://127.0.0.1:4040/?token=right&x=1", root)
    refute page =~ "right"
    assert File.read!(page) =~ ~s(url=http://127.0.0.1:4040/?token=right&amp;x=1")
    assert Desktop.opener_argument("http://127.0.0.1:4040/", root) == "http://127.0.0.1:4040/"
  end
end
