defmodule Situ.OptionsTest do
  use ExUnit.Case, async: true
  doctest Situ.Options

  test "{:integer, min, max} accepts integers only, and {:range, min, max} any number" do
    schema = [port: [type: {:integer, 1, 65_535}], share: [type: {:range, 0, 1}]]
    assert {:ok, [port: 80, share: 0.5]} = Situ.Options.validate([port: 80, share: 0.5], schema)
    assert {:error, error} = Situ.Options.validate([port: 80.5], schema)
    assert error.code == :bad_option and Exception.message(error) =~ "an integer from 1 to 65535"
  end

  describe "add_to_moduledoc/3" do
    test "appends the options after the module's purpose" do
      defmodule Greeter do
        @moduledoc "Greets people."
        Situ.Options.add_to_moduledoc(
          __MODULE__,
          [name: [type: :string, doc: "The person to greet."]],
          "Settings"
        )

        {_line, text} = Module.get_attribute(__MODULE__, :moduledoc)
        @text text
        def text, do: @text
      end

      assert Greeter.text() ==
               "Greets people.\n\n## Settings\n\n  * `:name` (a string) - The person to greet.\n"
    end

    test "leaves a private module without documentation" do
      defmodule Private do
        @moduledoc false
        Situ.Options.add_to_moduledoc(__MODULE__,
          name: [type: :string, doc: "The person to greet."]
        )

        {_line, text} = Module.get_attribute(__MODULE__, :moduledoc)
        @text text
        def text, do: @text
      end

      refute Private.text()
    end
  end
end
