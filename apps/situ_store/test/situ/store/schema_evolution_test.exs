defmodule Situ.Store.SchemaEvolutionTest do
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.Person

  @moduletag :tmp_dir

  test "values recorded as :any are checked when read with a type", %{tmp_dir: root} do
    streams = [{"Mixed", messages([1, 2, :odd]), []}, {"Typed", messages([1]), [type: :integer]}]
    store = Store.open!(store(root, streams))
    assert Enum.count(Store.messages(store, "Mixed", type: {:or, [:integer, :atom]})) == 3

    error =
      assert_raise Situ.Error, fn ->
        Store.messages(store, "Mixed", type: :integer) |> Enum.to_list()
      end

    assert error.code == :schema_mismatch and error.why =~ ":odd" and error.fix =~ ":any"
    error = assert_raise Situ.Error, fn -> Store.messages(store, "Typed", type: :string) end
    assert error.code == :schema_mismatch and error.fix =~ ":integer"

    error =
      assert_raise Situ.Error, fn ->
        store |> Store.messages("Mixed", type: Person) |> Enum.to_list()
      end

    assert error.why =~ "it is 1"
  end

  test "reads older recordings with a compatible newer struct only", %{tmp_dir: root} do
    path = store(root, [{"p", messages([%Person{name: "Ada", age: 3}]), [type: Person]}])
    store = Store.open!(path)

    Code.eval_string(
      "defmodule Situ.Store.Test.PersonNow do defstruct [name: \"\", age: 0, email: :none] end"
    )

    Code.eval_string("defmodule Situ.Store.Test.PersonCut do defstruct [name: \"\"] end")
    now = Situ.Store.Test.PersonNow
    [message] = Enum.to_list(Store.messages(store, "p", type: now))
    assert Map.from_struct(message.data) == %{name: "Ada", age: 3, email: :none}

    error =
      assert_raise Situ.Error, fn ->
        Store.messages(store, "p", type: Situ.Store.Test.PersonCut)
      end

    assert error.code == :schema_mismatch and error.why =~ "age"

    Code.eval_string(
      "defmodule Situ.Store.Test.PersonStrict do @enforce_keys [:age, :id]; defstruct [:id, name: \"\", age: 0] end"
    )

    error =
      assert_raise Situ.Error, fn ->
        Store.messages(store, "p", type: Situ.Store.Test.PersonStrict)
      end

    assert error.code == :schema_mismatch and error.why =~ ~r/not recorded: id$/
  end
end
