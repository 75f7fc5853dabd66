"""The families of compensators, one module each; `learning.model.registry` names them."""
